"""RAPL: representation alignment from preference rankings (paper, section III-B)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from rapl_core.representations.alignment import (
    Fit,
    Lesson,
    OnEpoch,
    build_encoder,
    check_recipe,
    fit_embedder,
)
from rapl_core.representations.answer_noise import log_likelihood
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.presets import Preset
from rapl_core.representations.report import AlignmentReport
from rapl_core.representations.training import Batch, Features, TiedTriplet
from rapl_core.transport import ot_distance
from rapl_core.types import Triplet


@dataclass(frozen=True)
class RaplObjective:
    """Bradley-Terry over transport distances to the best video of a triplet."""

    preset: Preset

    def loss(self, batch: Batch) -> torch.Tensor:
        """Mean loss of a batch: eq. representation_alignment_loss and the preset's own terms."""
        margin = self._margin(batch.videos)  # (B,) log-odds of the order
        if self.preset.likelihood == "log":
            loss = -log_likelihood(margin, batch.mistakes, self.preset.noise).mean()
        else:  # sums of probabilities are bounded as they are
            loss = (1.0 - torch.sigmoid(margin)).mean()
        if self.preset.tie_weight and batch.ties.shape[1]:
            tied = self._margin(batch.ties)
            loss = loss + self.preset.tie_weight * (0.5 - torch.sigmoid(tied)).square().mean()
        if self.preset.expert_weight:
            loss = loss + self.preset.expert_weight * self._expert_loss(
                batch.videos, batch.experts, batch.mistakes
            )
        return loss

    def correct(self, batch: Batch) -> torch.Tensor:
        """(B,) 1 where the middle video is closer to the best than the worst is."""
        return (self._margin(batch.videos) > 0).float()

    def _margin(self, z: torch.Tensor) -> torch.Tensor:
        """(3, B, T, D) -> (B,) d(best, worst) - d(best, middle) over the temperature."""
        middle, worst = ot_distance(z[:1], z[1:], self.preset.training).unbind()  # (B,) each
        return (worst - middle) / self.preset.temperature

    def _expert_loss(
        self, z: torch.Tensor, experts: torch.Tensor, mistakes: torch.Tensor | None
    ) -> torch.Tensor:
        """Bradley-Terry over all three pairs, by the mean distance to experts (E, T, D).

        Departs from the paper: it ties the distance to the reward that will be made of it.
        """
        far = ot_distance(z[:, :, None], experts, self.preset.training).mean(-1)  # (3, B)
        best, middle, worst = far / self.preset.temperature
        pairs = torch.stack([middle - best, worst - middle, worst - best])  # (3, B)
        return -log_likelihood(pairs, mistakes, self.preset.noise).sum(0).mean()


def align(
    features: FeatureStore,
    triplets: Sequence[Triplet],
    expert_ids: Sequence[str],
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
    ties: Sequence[TiedTriplet] = (),
    held_out: Sequence[Triplet] | None = None,
) -> tuple[Encoder, AlignmentReport]:
    """Learn an encoder from rankings.

    :param features: of training videos only, read as ``preset.recipe`` says. Videos in no triplet
        serve the statistics and the reward's scale.
    :param expert_ids: D+, the most preferred videos.
    :param on_epoch: called after each epoch; what it raises ends the training.
    :param ties: used by presets with a ``tie_weight``.
    :param held_out: triplets that choose the best epoch; None: ``preset.held_out`` of all.
    :raises RankingError: if there is no triplet or expert, or a video has no features.
    :raises ShapeError: if the features are not those of the preset.
    """
    started = time.monotonic()
    check_recipe(features, preset)
    lesson = Lesson(triplets, expert_ids, ties, held_out)
    fit = fit_rapl(features, lesson, preset, rng, on_epoch)
    return build_encoder("rapl", features, lesson, fit, preset, "ot", rng, started)


def fit_rapl(
    features: Features,
    lesson: Lesson,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> Fit:
    """RAPL on any per-video features (T, F), such as true states; see :func:`align`."""
    objective = RaplObjective(preset)
    return fit_embedder(features, lesson, objective, preset.dimension, preset, rng, on_epoch)
