"""Encoders that learn nothing here: a backbone's features as they are, and two controls."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rapl_core.errors import RankingError
from rapl_core.representations.alignment import (
    card_for,
    check_recipe,
    fit_projection,
    with_reward_scale,
)
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.heads import Embedder
from rapl_core.representations.methods import get_method
from rapl_core.representations.presets import PAPER, Preset
from rapl_core.transport import TransportConfig

RAW_RECIPE = PAPER.recipe
"""The backbone's last layer, averaged over the picture."""

MEAN_DISTANCE = TransportConfig(cost="cosine", solver="uniform", expert="mean")
"""The control ``mean_distance``: a frame's mean distance to all expert frames."""


def raw_preset(method: str, preset: Preset = PAPER) -> Preset:
    """The preset with the transport of a method that learns nothing."""
    return replace(preset, reward=MEAN_DISTANCE) if method == "mean_distance" else preset


def raw_encoder(
    backbone: str | None = None, weights: Path | None = None, method: str = "imagenet"
) -> Encoder:
    """The raw features of a backbone, with the paper's transport, at reward scale 1.

    :param backbone: None: the method's own.
    :raises UnknownNameError, WeightsError: from loading the backbone.
    """
    known = get_method(method)
    extractor = make_extractor(backbone or known.backbone, RAW_RECIPE, weights)
    embedder, preset = Embedder(None, None), raw_preset(method)
    return Encoder(
        extractor, embedder, card_for(method, extractor, embedder, preset, known.reward, ())
    )


def raw_encoder_from(
    features: FeatureStore,
    expert_ids: Sequence[str],
    rng: np.random.Generator,
    method: str = "imagenet",
    preset: Preset = PAPER,
    has_own_backbone: bool = False,
) -> Encoder:
    """The same with experts and a reward scale, from the raw features of training videos.

    :param features: extracted with the preset's recipe.
    :param preset: features, statistics and transport; its training plays no part.
    :param has_own_backbone: whether the backbone was trained here and belongs into a checkpoint.
    :raises RankingError: if there is no expert or one has no features.
    :raises ShapeError: if the features were extracted otherwise.
    """
    check_recipe(features, preset)
    missing = [name for name in expert_ids if name not in features]
    if missing or not expert_ids:
        raise RankingError(
            f"{len(expert_ids)} expert videos of which {len(missing)} have no features"
            + (f", such as {missing[0]}" if missing else ", expected at least one")
        )
    embedder = Embedder(fit_projection(features, preset, rng), None)
    kind, used = get_method(method).reward, raw_preset(method, preset)
    card = card_for(method, features.extractor, embedder, used, kind, expert_ids)
    card = replace(card, has_own_backbone=has_own_backbone)
    plain = Encoder(features.extractor, embedder, card)
    embeddings = {name: plain.embed_features(features[name]) for name in features}
    return Encoder(features.extractor, embedder, with_reward_scale(card, embeddings, rng))
