"""Training of a head on frozen features: data, the loop, its history."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from rapl_core.errors import ConvergenceError
from rapl_core.representations.presets import Preset
from rapl_core.types import DoubtedTriplet, Triplet

SLOW_PAIRS = 768
"""Pairs of frames of any video a batch."""

Features = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class TiedTriplet:
    """A better video and two that were ranked equal below it."""

    best: str
    first: str
    second: str


@dataclass(frozen=True)
class Batch:
    """What a loss sees."""

    videos: torch.Tensor
    """(3, B, T, K) best, middle and worst video of each triplet."""
    experts: torch.Tensor
    """(E, T, K)"""
    ties: torch.Tensor
    """(3, B', T, K) best, first and second video of each tied triplet; B' may be 0."""
    mistakes: torch.Tensor | None = None
    """(B,) probability that a comparison of each triplet was answered wrong; None: none was."""
    slow: torch.Tensor | None = None
    """(2, P, K) two frames of one video, a fixed time apart."""


@dataclass(frozen=True)
class EpochProgress:
    """One epoch of training."""

    epoch: int
    """1, 2, ..."""
    epochs: int
    loss: float
    held_out_loss: float
    """NaN without held-out triplets."""
    held_out_accuracy: float
    """Share of held-out triplets in the right order; NaN without any."""


class Objective(Protocol):
    """What is learnt: a loss to lower, and whether each triplet comes out in the right order."""

    def loss(self, head: nn.Module, batch: Batch) -> torch.Tensor:
        """Mean loss of a batch, a scalar."""
        ...

    def correct(self, head: nn.Module, batch: Batch) -> torch.Tensor:
        """(B,) share of the comparisons of each triplet that come out right."""
        ...


class TrainingData:
    """Videos as one tensor, and the triplets that refer to them."""

    def __init__(
        self,
        videos: Features,
        train: Sequence[Triplet],
        held_out: Sequence[Triplet],
        expert_ids: Sequence[str],
        ties: Sequence[TiedTriplet],
        frames: int | None,
        expert_from: float = 0.0,
    ) -> None:
        """
        :param videos: (T, K) projected features of every video that is referred to.
        :param frames: resample to this many frames; None: to the shortest video's.
        :param expert_from: share of the expert videos that is passed over.
        """
        names = sorted(videos)
        length = frames or min(len(videos[name]) for name in names)
        row = {name: i for i, name in enumerate(names)}
        self.videos = torch.stack([_resampled(videos[name], length) for name in names])  # (V, T, K)
        self.train = _rows([(t.best, t.middle, t.worst) for t in train], row)  # (M, 3)
        self.held_out = _rows([(t.best, t.middle, t.worst) for t in held_out], row)
        self.train_mistakes, self.held_out_mistakes = _mistakes(train), _mistakes(held_out)  # (M,)
        self.ties = _rows([(t.best, t.first, t.second) for t in ties], row)
        self.expert_start = min(round(expert_from * length), length - 1)
        self.experts = torch.tensor([row[name] for name in expert_ids])  # (E,)

    def batch(
        self, triplets: torch.Tensor, experts: torch.Tensor, ties: torch.Tensor, start: int = 0
    ) -> Batch:
        """Videos of the given rows from frame ``start`` on."""
        cut = self.videos[:, start:]
        matched = self.videos[experts, max(start, self.expert_start) :]
        return Batch(cut[triplets.T], matched, cut[ties.T])

    def slow(self, pairs: int, lag: float, rng: np.random.Generator) -> torch.Tensor:
        """(2, P, K) frames of any videos, the later one ``lag`` of the video later."""
        count, length = self.videos.shape[:2]
        ahead = min(max(round(lag * length), 1), length - 1)
        videos = torch.from_numpy(rng.integers(count, size=pairs))
        earlier = torch.from_numpy(rng.integers(max(length - ahead, 1), size=pairs))
        return torch.stack([self.videos[videos, t] for t in (earlier, earlier + ahead)])


@dataclass(frozen=True)
class History:
    """How a training went."""

    epochs: tuple[EpochProgress, ...]
    best_epoch: int
    """Whose weights were kept: the least held-out loss, or training loss without held-outs."""


def train_head(
    head: nn.Module,
    objective: Objective,
    data: TrainingData,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: Callable[[EpochProgress], None] | None = None,
) -> History:
    """Train ``head`` in place and leave it at its best epoch.

    :param on_epoch: called after every epoch; what it raises ends the training.
    :raises ConvergenceError: if the loss becomes NaN or infinite.
    """
    kind = torch.optim.AdamW if preset.optimiser == "adamw" else torch.optim.Adam
    optimiser = kind(head.parameters(), lr=preset.learning_rate, weight_decay=preset.weight_decay)
    epochs: list[EpochProgress] = []
    best, best_epoch, best_state = math.inf, 0, copy.deepcopy(head.state_dict())
    for epoch in range(1, preset.epochs + 1):
        losses = []
        for batch in _batches(data, preset, rng):
            optimiser.zero_grad()
            loss = objective.loss(head, batch)
            if batch.slow is not None:
                loss = loss + preset.slow_weight * slowness(head(batch.slow))
            if not bool(torch.isfinite(loss)):
                raise ConvergenceError(
                    f"the loss became {float(loss.detach())} in epoch {epoch} of preset "
                    f"{preset.name}; lower learning_rate ({preset.learning_rate})"
                )
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            losses.append(float(loss.detach()))
        held_loss, accuracy = _held_out(head, objective, data)
        progress = EpochProgress(epoch, preset.epochs, float(np.mean(losses)), held_loss, accuracy)
        epochs.append(progress)
        measure = progress.loss if math.isnan(held_loss) else held_loss
        if measure < best:
            best, best_epoch, best_state = measure, epoch, copy.deepcopy(head.state_dict())
        if on_epoch:
            on_epoch(progress)
        if preset.patience is not None and epoch - best_epoch >= preset.patience:
            break
    head.load_state_dict(best_state)
    return History(tuple(epochs), best_epoch)


def slowness(z: torch.Tensor) -> torch.Tensor:
    """How far embeddings (2, P, D) of one video move, over how far apart all lie (a scalar).

    Departs from the paper: the arm moves in every frame of every video and earns a reward that
    only rankings with mimes speak against; what is slower is preferred.
    """
    moved: torch.Tensor = torch.linalg.vector_norm(z[1] - z[0], dim=-1).mean()
    spread: torch.Tensor = torch.linalg.vector_norm(z[0] - z[0].mean(0), dim=-1).mean()
    return moved / spread.clamp_min(1e-6)


def _batches(data: TrainingData, preset: Preset, rng: np.random.Generator) -> list[Batch]:
    """One epoch: every triplet once; ties, experts and cuts drawn anew for each batch."""
    count = len(data.train)
    order = torch.from_numpy(rng.permutation(count))
    longest = int(preset.longest_cut * data.videos.shape[1])
    batches = []
    for rows in order.tensor_split(math.ceil(count / preset.batch_size)):
        experts = rng.permutation(len(data.experts))[: preset.experts_per_batch]
        ties = rng.permutation(len(data.ties))[: len(rows)]
        batches.append(
            replace(
                data.batch(
                    data.train[rows],
                    data.experts[torch.from_numpy(experts)],
                    data.ties[torch.from_numpy(ties)],
                    start=int(rng.integers(longest + 1)),
                ),
                mistakes=data.train_mistakes[rows],
                slow=data.slow(SLOW_PAIRS, preset.slow_lag, rng) if preset.slow_weight else None,
            )
        )
    return batches


def _held_out(head: nn.Module, objective: Objective, data: TrainingData) -> tuple[float, float]:
    if not len(data.held_out):
        return math.nan, math.nan
    batch = replace(
        data.batch(data.held_out, data.experts, data.ties[:0]), mistakes=data.held_out_mistakes
    )
    with torch.no_grad():
        loss = float(objective.loss(head, batch))
        return loss, float(objective.correct(head, batch).mean())


def _rows(names: Sequence[tuple[str, str, str]], row: Mapping[str, int]) -> torch.Tensor:
    rows = [[row[name] for name in triplet] for triplet in names]
    return torch.tensor(rows, dtype=torch.int64).reshape(-1, 3)


def _mistakes(triplets: Sequence[Triplet]) -> torch.Tensor:
    """(M,) those of :class:`DoubtedTriplet`; 0 of the others."""
    rates = [t.mistakes if isinstance(t, DoubtedTriplet) else 0.0 for t in triplets]
    return torch.tensor(rates, dtype=torch.float32)


def _resampled(video: NDArray[np.float32], length: int) -> torch.Tensor:
    if len(video) == length:
        return torch.from_numpy(video)
    return torch.from_numpy(video[np.linspace(0, len(video) - 1, length).round().astype(int)])
