"""RLHF: a scalar reward a frame, learnt from the same rankings (Christiano et al. 2017)."""

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
from rapl_core.representations.training import Batch, Features
from rapl_core.types import Noise, Triplet


@dataclass(frozen=True)
class RlhfObjective:
    """Bradley-Terry over all three pairs, by sums of per-frame scalars."""

    noise: Noise = "plain"

    def loss(self, batch: Batch) -> torch.Tensor:
        """Mean over triplets of the sum over their pairs."""
        margins = torch.stack(self._margins(batch))  # (3, B)
        return -log_likelihood(margins, batch.mistakes, self.noise).sum(0).mean()

    def correct(self, batch: Batch) -> torch.Tensor:
        """(B,) share of the three pairs in the right order."""
        return torch.stack([(m > 0).float() for m in self._margins(batch)]).mean(0)

    def _margins(self, batch: Batch) -> list[torch.Tensor]:
        """For each pair (B,): the better video's return minus the worse one's."""
        best, middle, worst = batch.videos[..., 0].sum(-1)  # (3, B)
        return [best - middle, middle - worst, best - worst]


def learn_reward(
    features: FeatureStore,
    triplets: Sequence[Triplet],
    expert_ids: Sequence[str],
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
    held_out: Sequence[Triplet] | None = None,
) -> tuple[Encoder, AlignmentReport]:
    """Learn an encoder whose embedding (D = 1) is the reward itself.

    Rankings leave its zero undetermined: it is set to the mean over the experts' frames, as
    transport rewards are zero at the experts. Uses the preset's features, optimiser, epochs and
    cuts; its distances play no part. Parameters and errors as of :func:`rapl.align`.
    """
    started = time.monotonic()
    check_recipe(features, preset)
    lesson = Lesson(triplets, expert_ids, held_out=held_out)
    fit = fit_rlhf(features, lesson, preset, rng, on_epoch)
    return build_encoder("rlhf", features, lesson, fit, preset, "scalar", rng, started)


def fit_rlhf(
    features: Features,
    lesson: Lesson,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> Fit:
    """RLHF on any per-video features (T, F); see :func:`learn_reward`."""
    fit = fit_embedder(features, lesson, RlhfObjective(preset.noise), 1, preset, rng, on_epoch)
    zero_at_experts(fit, features, lesson)
    return fit


def zero_at_experts(fit: Fit, features: Features, lesson: Lesson) -> None:
    """Shift the head so that the mean reward over the experts' frames is zero."""
    expert_frames = np.concatenate([fit.embed(features[name]) for name in lesson.expert_ids])
    head = fit.embedder.head
    if head is not None:
        with torch.no_grad():
            head.bias.sub_(float(expert_frames.mean()))
