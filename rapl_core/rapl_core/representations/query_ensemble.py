r"""What an ensemble of RAPL representations expects people to answer: for choosing triplets.

RAPL learns from a ranking what it says about transport distances: that the middle video is nearer
to the best one than the worst is. So the query that teaches most is the one about whose distances
an ensemble disagrees; a linear utility cannot see that."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import logsigmoid

from rapl_core.preferences.answers import AnswerModel, triplet_orders
from rapl_core.preferences.expert_set import expert_set
from rapl_core.preferences.triplets import triplets_from
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.presets import Preset
from rapl_core.representations.rapl import fit_rapl
from rapl_core.representations.training import Features
from rapl_core.transport import ot_distance
from rapl_core.types import Ranking, Triplet

MEMBERS = 4
FEWEST_TRIPLETS = 10
EPOCHS = 12
FRAMES = 10
COMPONENTS = 64
EXPERTS = 10


class TransportEnsemble:
    """Learns small RAPL representations, each from its own resampling of the triplets.

    :param features: (T, F) of every video that may be asked about, in the order of ``names``.
    :param preset: what the representation at the end is learnt with; the members use fewer epochs,
        frames and components.
    """

    def __init__(
        self, features: Features, names: Sequence[str], preset: Preset, rng: np.random.Generator
    ) -> None:
        self._names = tuple(names)
        self._rng = rng
        self._preset = replace(
            preset,
            epochs=EPOCHS,
            frames=FRAMES,
            components=COMPONENTS if preset.has_projection else preset.components,
            held_out=0.0,
        )
        self._features = {name: _thinned(features[name]) for name in self._names}

    def __call__(self, rankings: Sequence[Ranking]) -> AnswerModel | None:
        """Return the ensemble; None while there are too few triplets."""
        known = set(self._names)
        rankings = [r for r in rankings if r.ranks and known.issuperset(r.episode_ids)]
        triplets = triplets_from(rankings)
        if len(triplets) < FEWEST_TRIPLETS:
            return None
        ranked = {video for r in rankings for video in r.episode_ids}
        experts = expert_set(rankings, min(EXPERTS, len(ranked)))
        members = [self._member(triplets, experts) for _ in range(MEMBERS)]
        return TransportAnswers(torch.stack(members), self._experts(experts), self._preset)

    def _member(self, triplets: Sequence[Triplet], experts: Sequence[str]) -> torch.Tensor:
        """(n, T, D) embeddings of all videos by one member."""
        drawn = self._rng.integers(len(triplets), size=len(triplets))
        lesson = Lesson([triplets[int(i)] for i in drawn], experts)
        fit = fit_rapl(self._features, lesson, self._preset, self._rng)
        z = [fit.embed(self._features[name]) for name in self._names]
        return torch.from_numpy(np.stack(z))

    def _experts(self, experts: Sequence[str]) -> torch.Tensor:
        return torch.tensor([self._names.index(name) for name in experts])


class TransportAnswers:
    """The likelihood by which RAPL learns, over the six orders of three videos."""

    def __init__(self, z: torch.Tensor, experts: torch.Tensor, preset: Preset) -> None:
        """
        :param z: (K, n, T, D) embeddings.
        :param experts: (E,) rows of the expert videos.
        """
        self._z, self._preset = z, preset
        start = min(round(preset.expert_from * z.shape[2]), z.shape[2] - 1)
        self._matched = z[:, experts, start:]  # (K, E, T', D)

    def orders(self, candidates: NDArray[np.int64]) -> NDArray[np.float64]:
        """See :class:`rapl_core.preferences.answers.AnswerModel`; three videos only."""
        tau, config = self._preset.temperature, self._preset.training
        with torch.inference_mode():
            videos = self._z[:, torch.from_numpy(candidates)]  # (K, C, 3, T, D)
            far = ot_distance(videos[:, :, :, None], self._matched[:, None, None], config).mean(-1)
            between = {
                (i, j): ot_distance(videos[:, :, i], videos[:, :, j], config)
                for i in range(3)
                for j in range(i)
            }
            logits = []
            for best, middle, worst in permutations(range(3)):
                near = between[max(best, middle), min(best, middle)]
                apart = between[max(best, worst), min(best, worst)]
                value = logsigmoid((apart - near) / tau)
                for better, worse in ((best, middle), (middle, worst), (best, worst)):
                    gap = (far[..., worse] - far[..., better]) / tau
                    value = value + self._preset.expert_weight * logsigmoid(gap)
                logits.append(value.double().numpy())  # (K, C)
        return triplet_orders(logits)


def _thinned(video: NDArray[np.float32]) -> NDArray[np.float32]:
    """As many frames as the members look at: the rest would only cost time."""
    return np.asarray(video[np.linspace(0, len(video) - 1, FRAMES).round().astype(int)])
