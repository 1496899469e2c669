"""Loaders of checkpoints that others published and no package registry carries.

Layouts: docs/paper_notes.md. Each file is read as tensors only, checked against the SHA-256 in its
name or in ``<file>.sha256`` beside it, and must fit the network tensor by tensor.
"""

import os
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from timm.models import byobnet, vision_transformer
from torch import nn

from rapl_core.errors import WeightsError
from rapl_core.representations.backbone_spec import BackboneSpec
from rapl_core.representations.preprocessing import IMAGENET_MEAN, IMAGENET_STD, Preprocessing
from rapl_core.representations.weights import WEIGHTS_SUFFIXES, StateDict

WEIGHTS_FOLDER = "RAPL_WEIGHTS"
"""Environment variable: a folder with ``<backbone>.pt``, ``.pth`` or ``.safetensors``."""

_CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
_CLIP_STD = (0.26862954, 0.26130258, 0.27577711)
_LIKE_IMAGENET = Preprocessing(224, 224, shorter_side=256, mean=IMAGENET_MEAN, std=IMAGENET_STD)


def weights_folder() -> Path:
    """Where they are looked for."""
    return Path(os.environ.get(WEIGHTS_FOLDER, "~/.cache/rapl/weights")).expanduser()


def _look_for(name: str, what: str, usual: Iterable[str]) -> Path:
    """The file where users keep it.

    :raises WeightsError: saying where it is to be had and how to give it.
    """
    folder = weights_folder()
    places = [folder / f"{name}{suffix}" for suffix in WEIGHTS_SUFFIXES]
    places += [Path(place).expanduser() for place in usual]
    for place in places:
        if place.is_file():
            return place
    raise WeightsError(
        f"weights for {name} are not here and no package carries them. They are {what}. Fetch "
        f"that file, then give its path, or a folder that holds it as {name}.pt, with the option "
        f"`weights`, or put it at {places[0]}"
    )


def _drop(state: StateDict, *prefixes: str) -> StateDict:
    return {k: v for k, v in state.items() if not k.startswith(prefixes)}


def _below(state: StateDict, prefix: str, source: str) -> StateDict:
    """Tensors below a prefix, without it."""
    found = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
    if not found:
        raise WeightsError(
            f"{source} are of another layout: no tensor begins with '{prefix}'; "
            f"there is {next(iter(state))}"
        )
    return found


def _with_counters(network: nn.Module, state: StateDict) -> StateDict:
    counters = {k: v for k, v in network.state_dict().items() if k.endswith("num_batches_tracked")}
    return {**counters, **state}


def _r3m(network: nn.Module, state: StateDict, source: str) -> StateDict:
    """R3M keeps an image network without its last layer beside two language parts."""
    return _with_counters(network, _below(state, "module.convnet.", source))


def _vip(network: nn.Module, state: StateDict, source: str) -> StateDict:
    return _with_counters(network, _below(state, "module.convnet.", source))


def _liv(network: Any, state: StateDict, source: str) -> StateDict:
    """LIV is a CLIP model; of it only the image tower counts."""
    tower = {
        f"visual.{k}": v.float() for k, v in _below(state, "module.model.visual.", source).items()
    }
    return _with_counters(network, byobnet.checkpoint_filter_fn(tower, network))


def _transformer(network: Any, state: StateDict, source: str) -> StateDict:
    """Masked autoencoders and DINOv2: timm's names, and parts that only training needs."""
    encoder = _drop(state, "decoder_", "mask_token", "module.decoder_", "head.", "fc_norm.")
    own = network.state_dict()
    for name in ("cls_token", "pos_embed"):
        if name not in encoder or encoder[name].shape[-1] != own[name].shape[-1]:
            found = tuple(encoder[name].shape) if name in encoder else "missing"
            raise WeightsError(
                f"{source} are of another architecture: {name} is {found}, "
                f"expected width {own[name].shape[-1]}"
            )
    return dict(vision_transformer.checkpoint_filter_fn(encoder, network))


def _xirl(network: nn.Module, state: StateDict, source: str) -> StateDict:
    """XIRL numbers the layers of a ResNet-18 and calls its last layer the encoder."""
    numbered = {
        "0": "conv1",
        "1": "bn1",
        "4": "layer1",
        "5": "layer2",
        "6": "layer3",
        "7": "layer4",
    }
    named: StateDict = {}
    for name, tensor in _below(state, "backbone.", source).items():
        number, _, rest = name.partition(".")
        named[f"{numbered.get(number, number)}.{rest}"] = tensor
    named |= {f"fc.{k}": v for k, v in _below(state, "encoder.", source).items()}
    return _with_counters(network, named)


def _spec(
    name: str,
    title: str,
    architecture: str,
    preprocessing: Preprocessing,
    what: str,
    translate: Callable[[nn.Module, StateDict, str], StateDict],
    usual: tuple[str, ...] = (),
    **more: object,
) -> BackboneSpec:
    return BackboneSpec(
        name=name,
        title=title,
        architecture=architecture,
        preprocessing=preprocessing,
        default_weights=partial(_look_for, name, what, usual),
        translate=translate,
        origin=what,
        **more,  # type: ignore[arg-type]
    )


def _mvp(size: str, file: str, image: int, width: str) -> BackboneSpec:
    return _spec(
        f"mvp_vit_{size}",
        f"MVP (ViT-{width})",
        f"vit_{size}_patch16_224",
        Preprocessing(image, image, mean=IMAGENET_MEAN, std=IMAGENET_STD),
        f"'{file}' of https://github.com/ir413/mvp (CC-BY-NC 4.0)",
        _transformer,
        (f"/tmp/mvp-download-cache/{file}.pth", f"~/.cache/mvp/{file}.pth"),
        final="token",
        top_key="model",
        options={"img_size": image, "dynamic_img_size": True, "num_classes": 0},
    )


PUBLIC = (
    _spec(
        "r3m_resnet18",
        "R3M (ResNet-18)",
        "resnet18",
        _LIKE_IMAGENET,
        "'r3m_18/model.pt' of https://github.com/facebookresearch/r3m (MIT)",
        _r3m,
        ("~/.r3m/r3m_18/model.pt",),
        top_key="r3m",
        options={"num_classes": 0},
    ),
    _spec(
        "vip_resnet50",
        "VIP (ResNet-50)",
        "resnet50",
        _LIKE_IMAGENET,
        "'resnet50/model.pt' of https://github.com/facebookresearch/vip (CC-BY-NC 4.0)",
        _vip,
        ("~/.vip/resnet50/model.pt",),
        final="output",
        top_key="vip",
        options={"num_classes": 1024},
    ),
    _spec(
        "liv_resnet50",
        "LIV (CLIP ResNet-50)",
        "resnet50_clip",
        Preprocessing(224, 224, shorter_side=224, mean=_CLIP_MEAN, std=_CLIP_STD),
        "'resnet50/model.pt' of https://github.com/penn-pal-lab/LIV (MIT)",
        _liv,
        ("~/.liv/resnet50/model.pt",),
        final="output",
        top_key="liv",
        options={"num_classes": 1024},
    ),
    _mvp("small", "vits-mae-hoi", 224, "S"),
    _mvp("base", "vitb-mae-egosoup", 224, "B"),
    _mvp("large", "vitl-256-mae-egosoup", 256, "L"),
    _spec(
        "dinov2_vit_small",
        "DINOv2 (ViT-S/14)",
        "vit_small_patch14_dinov2",
        _LIKE_IMAGENET,
        "'dinov2_vits14_pretrain.pth' of https://github.com/facebookresearch/dinov2 (Apache-2.0)",
        _transformer,
        ("~/.cache/torch/hub/checkpoints/dinov2_vits14_pretrain.pth",),
        final="token",
        options={"img_size": 224, "dynamic_img_size": True, "num_classes": 0},
    ),
    _spec(
        "xirl_resnet18",
        "XIRL or RAPL by its authors (ResNet-18, 32-d)",
        "resnet18",
        Preprocessing(112, 112),
        "a checkpoint of https://github.com/google-research/google-research/tree/master/xirl "
        "or of RAPL's authors (Apache-2.0)",
        _xirl,
        final="output",
        top_key="model",
        options={"num_classes": 32},
    ),
)
