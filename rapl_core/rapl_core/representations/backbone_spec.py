"""What the registry knows of an image network before it is built."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from torch import nn

from rapl_core.representations.preprocessing import Preprocessing
from rapl_core.representations.weights import StateDict

Stage = Literal["stride2", "stride4", "stride8", "stride14", "stride16", "stride32", "final"]
"""The last feature map at this many pixels a cell; ``final``: what the network ends with."""

FinalOutput = Literal["map", "token", "output"]

Translation = Callable[[nn.Module, StateDict, str], StateDict]


def as_it_is(network: nn.Module, state: StateDict, source: str) -> StateDict:
    """The file has timm's names."""
    del network, source
    return state


@dataclass(frozen=True)
class BackboneSpec:
    """How to build a backbone and where its weights are."""

    name: str
    title: str
    """For tables: training data and network."""
    architecture: str
    """timm's name."""
    preprocessing: Preprocessing
    default_weights: Callable[[], Path]
    translate: Translation = as_it_is
    """From the file's names of tensors to timm's."""
    final: FinalOutput = "map"
    """``map``: the last feature map. ``token``: a transformer's class token after its last
    normalisation. ``output``: a vector from the network's own last layer."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of ``timm.create_model``."""
    top_key: str = ""
    """Under which a file keeps its tensors; empty: at the top."""
    url: str = ""
    """Whence ``default_weights`` fetches them when they are first asked for; empty: it does not."""
    origin: str = ""
    """What a user must fetch, and its licence, where no package carries them."""
