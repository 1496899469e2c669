"""What there is to choose about the node ``preference``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rapl_core.preferences import DeskConfig
from rapl_core.preferences.people import PeopleConfig
from rapl_core.representations.methods import Trained


@dataclass(frozen=True)
class PreferenceConfig(DeskConfig, PeopleConfig):
    """Parameters of the preference node."""

    run_folder: Path = Path(".")
    """Run folder: episodes/, rankings.sqlite, encoders/."""
    rankings_wanted: int = field(default=0, metadata={"minimum": 0})
    """Rankings wanted in all, for the figures of progress; 0: no number. May change at run time."""
    strategy: Literal[
        "uniform", "contest", "uncertainty", "information", "coverage", "transport", "own"
    ] = "uniform"
    """Which videos to ask about next; uniform: at random, as the paper; contest: in the end the
    strongest among themselves, needs rankings_wanted; own: the learner's newest, each two beside an
    expert video. May change at run time."""
    preset: str = "tuned"
    """Whose features strategies other than uniform look at."""
    purposes: tuple[str, ...] = ("demonstrate",)
    """Purposes of the episodes that are the pool of videos."""
    own_purpose: str = "train"
    """Purpose of the episodes that are the learner's own videos."""
    experts: int = field(default=10, metadata={"minimum": 1, "maximum": 1000})
    """Videos in the expert set, the most preferred by the rankings alone."""
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    """Of the features that alignment reads. bfloat16 is about three times as fast; what the robot
    is rewarded with is always embedded in float32."""
    threads: int = field(default=1, metadata={"minimum": 1, "maximum": 64})
    """Threads of torch."""
    backbone: str = ""
    """Network that alignment reads features from; empty: the one that the method names."""
    weights: str = ""
    """File with its weights, or a folder that holds it as <backbone>.pt; empty: where they are by
    default."""
    engine: Literal["torch", "openvino"] = "torch"
    """What computes the features that alignment reads of a network that stays as it is. openvino,
    where installed, must agree with torch (cosine 0.999) on the pool's pictures, and has its own
    precision."""
    trained: Trained = "head"
    """What alignment trains: the last layer (the paper), or the backbone's last block with it,
    which takes minutes where a layer takes seconds, and of tcc and tcc_ot an hour. Of these and of
    rapl and rlhf; nothing else has the choice."""
    tcc_iterations: int = field(default=4000, metadata={"minimum": 1, "maximum": 1_000_000})
    """Of tcc and tcc_ot."""
    masked_iterations: int = field(default=1500, metadata={"minimum": 1, "maximum": 1_000_000})
    """Of mae_scratch and mvp_finetuned."""

    def __post_init__(self) -> None:
        DeskConfig.__post_init__(self)
        PeopleConfig.__post_init__(self)
