"""The small transformer that a masked autoencoder pre-trains on a task's own frames."""

from pathlib import Path

from rapl_core.errors import WeightsError
from rapl_core.representations.backbone_spec import BackboneSpec
from rapl_core.representations.preprocessing import IMAGENET_MEAN, IMAGENET_STD, Preprocessing

MAE_BACKBONE = "mae_vit"

SIZE = 112
PATCH = 8
"""Pixels a side: 196 patches, and an object of 12 pixels is seen by more than one of them."""
WIDTH = 128
DEPTH = 4
HEADS = 4


def _none() -> Path:
    raise WeightsError(
        f"{MAE_BACKBONE} has no published weights: it is pre-trained on a run's own videos, by "
        "`--reward mae_scratch` or the action preference/align; or give its file with `weights`"
    )


MAE_SMALL = BackboneSpec(
    name=MAE_BACKBONE,
    title="masked autoencoder pre-trained here (small ViT)",
    architecture="vit_tiny_patch16_224",
    preprocessing=Preprocessing(SIZE, SIZE, mean=IMAGENET_MEAN, std=IMAGENET_STD),
    default_weights=_none,
    final="token",
    options={
        "img_size": SIZE,
        "patch_size": PATCH,
        "embed_dim": WIDTH,
        "depth": DEPTH,
        "num_heads": HEADS,
        "dynamic_img_size": True,
        "num_classes": 0,
    },
)
