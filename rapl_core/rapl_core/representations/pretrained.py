"""Encoders that learn nothing from rankings: a backbone's features as they are."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rapl_core.errors import RankingError
from rapl_core.representations.alignment import card_for, check_recipe, with_reward_scale
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.heads import Embedder
from rapl_core.representations.presets import PAPER

RAW_RECIPE = PAPER.recipe
"""The backbone's last layer, averaged over the picture."""


def raw_encoder(backbone: str, weights: Path | None = None) -> Encoder:
    """The raw features of a backbone, with the paper's transport, at reward scale 1.

    :raises UnknownNameError, WeightsError: from loading the backbone.
    """
    extractor = make_extractor(backbone, RAW_RECIPE, weights)
    embedder = Embedder(None, None)
    return Encoder(extractor, embedder, card_for("imagenet", extractor, embedder, PAPER, "ot", ()))


def raw_encoder_from(
    features: FeatureStore, expert_ids: Sequence[str], rng: np.random.Generator
) -> Encoder:
    """The same with experts and a reward scale, from the raw features of training videos.

    :param features: extracted with :data:`RAW_RECIPE`.
    :raises RankingError: if there is no expert or one has no features.
    :raises ShapeError: if the features were extracted otherwise.
    """
    check_recipe(features, PAPER)
    missing = [name for name in expert_ids if name not in features]
    if missing or not expert_ids:
        raise RankingError(
            f"{len(expert_ids)} expert videos of which {len(missing)} have no features"
            + (f", such as {missing[0]}" if missing else ", expected at least one")
        )
    embedder = Embedder(None, None)
    card = card_for("imagenet", features.extractor, embedder, PAPER, "ot", expert_ids)
    return Encoder(features.extractor, embedder, with_reward_scale(card, features, rng))
