"""The supervised probe: ridge regression on the human's own reward. A ceiling, never a reward.

It shows what the features hold; a method that learns from rankings cannot be expected to do better.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import RankingError
from rapl_core.representations.alignment import (
    card_for,
    check_recipe,
    fit_projection,
    project,
    with_reward_scale,
)
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.heads import Embedder, empty_head
from rapl_core.representations.presets import Preset
from rapl_core.representations.training import Features

_STRENGTHS = tuple(10.0**power for power in range(-2, 5))
_FOLDS = 5


def fit_probe(
    features: Features,
    human_rewards: Mapping[str, NDArray[np.float64]],
    preset: Preset,
    rng: np.random.Generator,
) -> tuple[Embedder, float]:
    """Ridge on r*, its strength chosen by cross-validation over videos.

    :param features: (T, F) by episode id.
    :param human_rewards: (T,) r* of the same frames.
    :return: an embedder to one dimension, and the chosen strength.
    :raises RankingError: if no video has a known r*.
    """
    names = [name for name in features if name in human_rewards]
    if len(names) < _FOLDS:
        raise RankingError(f"the supervised probe needs {_FOLDS} videos with r*, got {len(names)}")
    projection = fit_projection(features, preset, rng)
    x = [np.asarray(project(projection, features[n]), np.float64) for n in names]
    y = [np.asarray(human_rewards[n], np.float64) for n in names]
    fold = rng.permutation(len(names)) % _FOLDS
    errors = np.zeros(len(_STRENGTHS))
    for out in range(_FOLDS):
        kept = [i for i in range(len(names)) if fold[i] != out]
        held = [i for i in range(len(names)) if fold[i] == out]
        far, truth = np.concatenate([x[i] for i in held]), np.concatenate([y[i] for i in held])
        solve = _Ridge(np.concatenate([x[i] for i in kept]), np.concatenate([y[i] for i in kept]))
        for row, strength in enumerate(_STRENGTHS):
            weight, bias = solve(strength)
            errors[row] += float(np.square(far @ weight + bias - truth).sum())
    strength = _STRENGTHS[int(errors.argmin())]
    weight, bias = _Ridge(np.concatenate(x), np.concatenate(y))(strength)
    head = empty_head(len(weight), 1)
    with torch.no_grad():
        head.weight.copy_(torch.from_numpy(weight)[None])
        head.bias.fill_(float(bias))
    return Embedder(projection, head), strength


def supervised_probe(
    features: FeatureStore,
    human_rewards: Mapping[str, NDArray[np.float64]],
    expert_ids: Sequence[str],
    preset: Preset,
    rng: np.random.Generator,
) -> Encoder:
    """The probe as an encoder, so that one evaluation serves it too.

    :raises RankingError: if no video has a known r*.
    :raises ShapeError: if the features are not those of the preset.
    """
    check_recipe(features, preset)
    embedder, _ = fit_probe(features, human_rewards, preset, rng)
    card = card_for("supervised_probe", features.extractor, embedder, preset, "scalar", expert_ids)
    plain = Encoder(features.extractor, embedder, card)
    embeddings = {name: plain.embed_features(features[name]) for name in features}
    return Encoder(features.extractor, embedder, with_reward_scale(card, embeddings, rng))


class _Ridge:
    """Ridge regressions of one data set at several strengths, from one eigenbasis."""

    def __init__(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        self.mean, self.offset = x.mean(0), float(y.mean())
        centred = x - self.mean
        self.values, self.vectors = np.linalg.eigh(centred.T @ centred)
        self.target = self.vectors.T @ (centred.T @ (y - self.offset))

    def __call__(self, strength: float) -> tuple[NDArray[np.float64], float]:
        weight = self.vectors @ (self.target / (self.values + strength))
        return weight, self.offset - float(self.mean @ weight)
