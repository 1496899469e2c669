"""Visual representations: encoders, and learning them from rankings.

Names are imported at first use, since torch and timm take seconds to load.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rapl_core.representations.backbones import backbone_names, load_backbone
    from rapl_core.representations.card import EncoderCard
    from rapl_core.representations.checkpoints import (
        checkpoint_folder,
        load_encoder,
        save_encoder,
    )
    from rapl_core.representations.encoder import Encoder
    from rapl_core.representations.episode_embedder import EpisodeEmbedder
    from rapl_core.representations.extractor import FeatureRecipe, make_extractor
    from rapl_core.representations.features import FeatureStore, find_parts
    from rapl_core.representations.pooling import Pooling
    from rapl_core.representations.preprocessing import Preprocessing, preprocess
    from rapl_core.representations.presets import Preset, get_preset, preset_names
    from rapl_core.representations.pretrained import raw_encoder, raw_encoder_from
    from rapl_core.representations.rapl import align
    from rapl_core.representations.registry import encoder_names, make_encoder
    from rapl_core.representations.report import AlignmentReport
    from rapl_core.representations.rlhf import learn_reward
    from rapl_core.representations.training import EpochProgress, TiedTriplet

_HOMES = {
    "AlignmentReport": "report",
    "Encoder": "encoder",
    "EncoderCard": "card",
    "EpisodeEmbedder": "episode_embedder",
    "EpochProgress": "training",
    "FeatureRecipe": "extractor",
    "FeatureStore": "features",
    "Pooling": "pooling",
    "Preprocessing": "preprocessing",
    "Preset": "presets",
    "TiedTriplet": "training",
    "align": "rapl",
    "backbone_names": "backbones",
    "checkpoint_folder": "checkpoints",
    "encoder_names": "registry",
    "find_parts": "features",
    "get_preset": "presets",
    "learn_reward": "rlhf",
    "load_backbone": "backbones",
    "load_encoder": "checkpoints",
    "make_encoder": "registry",
    "make_extractor": "extractor",
    "preprocess": "preprocessing",
    "preset_names": "presets",
    "raw_encoder": "pretrained",
    "raw_encoder_from": "pretrained",
    "save_encoder": "checkpoints",
}

__all__ = [
    "AlignmentReport",
    "Encoder",
    "EncoderCard",
    "EpisodeEmbedder",
    "EpochProgress",
    "FeatureRecipe",
    "FeatureStore",
    "Pooling",
    "Preprocessing",
    "Preset",
    "TiedTriplet",
    "align",
    "backbone_names",
    "checkpoint_folder",
    "encoder_names",
    "find_parts",
    "get_preset",
    "learn_reward",
    "load_backbone",
    "load_encoder",
    "make_encoder",
    "make_extractor",
    "preprocess",
    "preset_names",
    "raw_encoder",
    "raw_encoder_from",
    "save_encoder",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
