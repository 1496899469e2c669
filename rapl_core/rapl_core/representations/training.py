"""Training of a head on frozen features: data, the loop, its history."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

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
"""(T, F) by the video's name."""


@dataclass(frozen=True)
class TiedTriplet:
    """A better video and two that were ranked equal below it."""

    best: str
    first: str
    second: str


@dataclass(frozen=True)
class Batch:
    """What a loss sees: embeddings."""

    videos: torch.Tensor
    """(3, B, T, D) best, middle and worst video of each triplet."""
    experts: torch.Tensor
    """(E, T', D)"""
    ties: torch.Tensor
    """(3, B', T, D) best, first and second video of each tied triplet; B' may be 0."""
    slow: torch.Tensor
    """(2, P, D) two frames of one video, a fixed time apart; P may be 0."""
    mistakes: torch.Tensor | None = None
    """(B,) probability that a comparison of each triplet was answered wrong; None: none was."""


@dataclass(frozen=True)
class Draw:
    """Which frames make a batch, as numbers among the frames of all videos; fields as there."""

    videos: NDArray[np.int64]
    experts: NDArray[np.int64]
    ties: NDArray[np.int64]
    slow: NDArray[np.int64]
    mistakes: NDArray[np.float32]


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

    def loss(self, batch: Batch) -> torch.Tensor:
        """Mean loss of a batch, a scalar."""
        ...

    def correct(self, batch: Batch) -> torch.Tensor:
        """(B,) share of the comparisons of each triplet that come out right."""
        ...


class TrainingData:
    """Frames of all videos as one matrix, and the triplets that refer to the videos."""

    def __init__(
        self,
        videos: Mapping[str, NDArray[Any]],
        train: Sequence[Triplet],
        held_out: Sequence[Triplet],
        expert_ids: Sequence[str],
        ties: Sequence[TiedTriplet],
        frames: int | None,
        expert_from: float = 0.0,
    ) -> None:
        """
        :param videos: (T, K) projected features of every video that is referred to, or of any
            other shape (T, ...) that the head takes.
        :param frames: resample to this many frames; None: to the shortest video's.
        :param expert_from: share of the expert videos that is passed over.
        """
        names = sorted(videos)
        self.length = frames or min(len(videos[name]) for name in names)
        row = {name: i for i, name in enumerate(names)}
        self.frames = torch.cat([_resampled(videos[n], self.length) for n in names])  # (V T, K)
        self.train = _rows([(t.best, t.middle, t.worst) for t in train], row)  # (M, 3)
        self.held_out = _rows([(t.best, t.middle, t.worst) for t in held_out], row)
        self.train_mistakes, self.held_out_mistakes = _mistakes(train), _mistakes(held_out)  # (M,)
        self.ties = _rows([(t.best, t.first, t.second) for t in ties], row)
        self.expert_start = min(round(expert_from * self.length), self.length - 1)
        self.experts = np.array([row[name] for name in expert_ids])  # (E,)

    def draw(
        self,
        triplets: NDArray[np.int64],
        mistakes: NDArray[np.float32],
        experts: NDArray[np.int64],
        ties: NDArray[np.int64],
        slow: NDArray[np.int64] | None = None,
        start: int = 0,
    ) -> Draw:
        """Videos of the given rows from frame ``start`` on, and pairs of frames."""
        return Draw(
            self._frames_of(triplets.T, start),
            self._frames_of(experts, max(start, self.expert_start)),
            self._frames_of(ties.T, start),
            np.empty((2, 0), np.int64) if slow is None else slow,
            mistakes,
        )

    def slow(self, pairs: int, lag: float, rng: np.random.Generator) -> NDArray[np.int64]:
        """(2, P) frames of any videos, the later one ``lag`` of the video later."""
        count = len(self.frames) // self.length
        ahead = min(max(round(lag * self.length), 1), self.length - 1)
        videos = rng.integers(count, size=pairs)
        earlier = rng.integers(max(self.length - ahead, 1), size=pairs)
        return videos * self.length + np.stack([earlier, earlier + ahead])

    def batch(self, head: nn.Module, draw: Draw) -> Batch:
        """Embed all frames of a draw at once: one product where each part would take its own."""
        parts = (draw.videos, draw.experts, draw.ties, draw.slow)
        numbers = torch.from_numpy(np.concatenate([part.ravel() for part in parts]))
        z = head(self.frames.index_select(0, numbers))  # (N, D)
        pieces = z.split([part.size for part in parts])
        videos, experts, ties, slow = (
            piece.view(*part.shape, z.shape[1]) for piece, part in zip(pieces, parts, strict=True)
        )
        return Batch(videos, experts, ties, slow, torch.from_numpy(draw.mistakes))

    def _frames_of(self, videos: NDArray[np.int64], start: int) -> NDArray[np.int64]:
        """(...) rows of videos -> (..., T) their frames from ``start`` on."""
        return videos[..., None] * self.length + np.arange(start, self.length)


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
    groups: Sequence[dict[str, Any]] | None = None,
    slow_pairs: int = SLOW_PAIRS,
    goes_on: bool = False,
) -> History:
    """Train ``head`` in place and leave it at its best epoch.

    :param on_epoch: called after every epoch; what it raises ends the training.
    :param groups: parameters to train with what differs from the preset's optimiser; None: all.
    :param slow_pairs: pairs of frames a batch for the preset's slowness.
    :param goes_on: whether the head has learnt already: if no epoch is better than it is now, it
        is left as it is, at best epoch 0.
    :raises ConvergenceError: if the loss becomes NaN or infinite.
    """
    kind = torch.optim.AdamW if preset.optimiser == "adamw" else torch.optim.Adam
    optimiser = kind(
        [{"params": head.parameters()}] if groups is None else list(groups),
        preset.learning_rate,
        weight_decay=preset.weight_decay,
        fused=True,
    )
    epochs: list[EpochProgress] = []
    best, best_epoch, best_state = math.inf, 0, copy.deepcopy(head.state_dict())
    if goes_on and len(data.held_out):
        best = _held_out(head, objective, data)[0]
    for epoch in range(1, preset.epochs + 1):
        losses = []
        for draw in _draws(data, preset, rng, slow_pairs):
            optimiser.zero_grad()
            batch = data.batch(head, draw)
            loss = objective.loss(batch)
            if preset.slow_weight:
                loss = loss + preset.slow_weight * slowness(batch.slow)
            losses.append(float(loss.detach()))
            if not math.isfinite(losses[-1]):
                raise ConvergenceError(
                    f"the loss became {losses[-1]} in epoch {epoch} of preset "
                    f"{preset.name}; lower learning_rate ({preset.learning_rate})"
                )
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
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
    earlier, later = z
    moved: torch.Tensor = torch.linalg.vector_norm(later - earlier, dim=-1).mean()
    spread: torch.Tensor = torch.linalg.vector_norm(earlier - earlier.mean(0), dim=-1).mean()
    return moved / spread.clamp_min(1e-6)


def _draws(
    data: TrainingData, preset: Preset, rng: np.random.Generator, slow_pairs: int
) -> list[Draw]:
    """One epoch: every triplet once; ties, experts and cuts drawn anew for each batch."""
    count = len(data.train)
    longest = int(preset.longest_cut * data.length)
    draws = []
    for rows in np.array_split(rng.permutation(count), math.ceil(count / preset.batch_size)):
        experts = rng.permutation(len(data.experts))[: preset.experts_per_batch]
        ties = rng.permutation(len(data.ties))[: len(rows)]
        start = int(rng.integers(longest + 1))
        slow = data.slow(slow_pairs, preset.slow_lag, rng) if preset.slow_weight else None
        chosen = (data.train[rows], data.train_mistakes[rows], data.experts[experts])
        draws.append(data.draw(*chosen, data.ties[ties], slow, start))
    return draws


def _held_out(head: nn.Module, objective: Objective, data: TrainingData) -> tuple[float, float]:
    if not len(data.held_out):
        return math.nan, math.nan
    with torch.no_grad():
        batch = data.batch(
            head,
            data.draw(data.held_out, data.held_out_mistakes, data.experts, data.ties[:0]),
        )
        return float(objective.loss(batch)), float(objective.correct(batch).mean())


def _rows(names: Sequence[tuple[str, str, str]], row: Mapping[str, int]) -> NDArray[np.int64]:
    rows = [[row[name] for name in triplet] for triplet in names]
    return np.array(rows, np.int64).reshape(-1, 3)


def _mistakes(triplets: Sequence[Triplet]) -> NDArray[np.float32]:
    """(M,) those of :class:`DoubtedTriplet`; 0 of the others."""
    rates = [t.mistakes if isinstance(t, DoubtedTriplet) else 0.0 for t in triplets]
    return np.array(rates, np.float32)


def _resampled(video: NDArray[Any], length: int) -> torch.Tensor:
    if len(video) == length:
        return torch.from_numpy(video)
    return torch.from_numpy(video[np.linspace(0, len(video) - 1, length).round().astype(int)])
