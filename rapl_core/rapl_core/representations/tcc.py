"""TCC: representations in which preferred demonstrations run through the same progress."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import kendalltau

from rapl_core.errors import ConvergenceError, RankingError, ShapeError, UnknownNameError
from rapl_core.representations.alignment import (
    OnEpoch,
    card_for,
    check_recipe,
    fit_projection,
    project,
    with_reward_scale,
)
from rapl_core.representations.augmentation import Augmentation
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.features import MIRRORED, FeatureStore
from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.methods import Trained, get_method
from rapl_core.representations.presets import Preset
from rapl_core.representations.tcc_loss import TccLossConfig, tcc_loss
from rapl_core.representations.training import EpochProgress, Features

Sampling = Literal["uniform", "even"]

VIEW_MARK = "-view"
"""``<id>-view<i>`` names a changed copy of a video among features."""

GOAL_FROM = 0.999
"""Only the last frame of a demonstration is its goal."""

_REPORTS = 40
_MOST_IN_TAU = 6


@dataclass(frozen=True)
class TccConfig:
    """Loss, sampling and training; the defaults are those of XIRL but for the learning rate."""

    loss: TccLossConfig = field(default_factory=TccLossConfig)
    frames: int = 40
    """Frames taken of each video."""
    sampling: Sampling = "uniform"
    """``uniform``: drawn at random without repetition, in order. ``even``: evenly spread."""
    videos: int = 4
    """A batch."""
    iterations: int = 4000
    trained: Trained = "head"
    """``head``: the last linear layer, on cached features. ``last_block``: the backbone's last
    block with it, on pictures (a hundred times slower)."""
    learning_rate: float = 1e-3
    """XIRL trains the whole network at 1e-5; a head alone takes more."""
    block_learning_rate: float = 1e-5
    weight_decay: float = 1e-4
    views: int = 1
    """Randomly changed copies of each video beside the video itself; 0: no augmentation."""
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        for what, name, known in (
            ("TCC sampling", self.sampling, get_args(Sampling)),
            ("trained part", self.trained, get_args(Trained)),
        ):
            if name not in known:
                raise UnknownNameError(what, name, known)
        for number, least in (("frames", 2), ("videos", 2), ("iterations", 1), ("views", 0)):
            if getattr(self, number) < least:
                raise ShapeError(
                    f"TccConfig.{number} is {getattr(self, number)}, expected at least {least}"
                )


@dataclass(frozen=True)
class TccReport:
    """How a training went."""

    method: str
    preset: str
    demonstrations: int
    iterations: int
    first_loss: float
    last_loss: float
    """Mean over a fortieth of the iterations."""
    kendall_tau: float
    """Of nearest neighbours between demonstrations, 1 when time runs alike in all."""
    reward_scale: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """A JSON object; NaN becomes null."""
        return {
            k: None if isinstance(v, float) and math.isnan(v) else v
            for k, v in asdict(self).items()
        }


def fit_tcc(
    features: Features,
    dimension: int,
    preset: Preset,
    config: TccConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> tuple[Embedder, tuple[float, ...]]:
    """Learn a head on any per-video features; no ranking is looked at.

    :param features: (T, F) by episode id; ``<id>-view<i>`` are changed copies, which take the
        video's place at random.
    :return: statistics and head, and the loss of each fortieth of the iterations.
    :raises RankingError: for fewer than two demonstrations.
    :raises ConvergenceError: if the loss becomes NaN or infinite.
    """
    names = originals(features)
    if len(names) < 2:
        raise RankingError(f"TCC needs two demonstrations or more, got {len(names)}")
    projection = fit_projection({n: features[n] for n in names}, preset, rng)
    videos = {name: torch.from_numpy(project(projection, features[name])) for name in features}
    copies = {name: [n for n in features if _original(n) == name] for name in names}
    width = next(iter(videos.values())).shape[1]
    head = linear_head(width, dimension, rng)
    optimiser = torch.optim.Adam(
        head.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )

    def embed_batch() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        drawn = draw_videos(names, config, rng)
        taken = [draw_frames(len(videos[name]), config, rng) for name in drawn]
        shown = [copies[name][int(rng.integers(len(copies[name])))] for name in drawn]
        batch = torch.stack([videos[s][rows] for s, rows in zip(shown, taken, strict=True)])
        lengths = torch.tensor([len(videos[name]) for name in drawn])
        return head(batch), torch.stack(taken), lengths

    losses = minimise(embed_batch, [optimiser], config, rng, on_epoch)
    return Embedder(projection, head), losses


def minimise(
    embed_batch: Callable[[], tuple[torch.Tensor, torch.Tensor, torch.Tensor]],
    optimisers: Sequence[torch.optim.Optimizer],
    config: TccConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None,
) -> tuple[float, ...]:
    """Lower the loss of batch after batch.

    :param embed_batch: (B, T, D) embeddings, (B, T) their frames, (B,) lengths of the videos.
    :return: mean loss of each fortieth of the iterations.
    """
    losses: list[float] = []
    means: list[float] = []
    chunk = max(1, config.iterations // _REPORTS)
    for iteration in range(1, config.iterations + 1):
        loss = tcc_loss(*embed_batch(), config.loss, rng)
        if not bool(torch.isfinite(loss)):
            raise ConvergenceError(
                f"the TCC loss became {float(loss.detach())} in iteration {iteration}; lower "
                f"learning_rate ({config.learning_rate})"
            )
        for optimiser in optimisers:
            optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        for optimiser in optimisers:
            optimiser.step()
        losses.append(float(loss.detach()))
        if iteration % chunk == 0 or iteration == config.iterations:
            means.append(float(np.mean(losses)))
            losses.clear()
            if on_epoch:
                on_epoch(EpochProgress(iteration, config.iterations, means[-1], math.nan, math.nan))
            if iteration == config.iterations:
                break
    return tuple(means)


def draw_videos(names: Sequence[str], config: TccConfig, rng: np.random.Generator) -> list[str]:
    """Distinct videos of a batch."""
    count = min(config.videos, len(names))
    return [names[int(i)] for i in rng.permutation(len(names))[:count]]


def draw_frames(length: int, config: TccConfig, rng: np.random.Generator) -> torch.Tensor:
    """Rows of ``config.frames`` frames of a video in order; repeated where it has fewer."""
    if config.sampling == "even":
        rows = np.linspace(0, length - 1, config.frames).round().astype(np.int64)
    else:
        short = length < config.frames
        rows = np.sort(rng.choice(length, config.frames, replace=short)).astype(np.int64)
    return torch.from_numpy(rows)


def learn_tcc(
    features: FeatureStore,
    expert_ids: Sequence[str],
    preset: Preset,
    config: TccConfig,
    rng: np.random.Generator,
    method: str = "tcc",
    on_epoch: OnEpoch | None = None,
    demonstrations: Sequence[str] | None = None,
) -> tuple[Encoder, TccReport]:
    """Learn an encoder from preferred demonstrations alone.

    :param features: of the demonstrations, and of changed copies named ``<id>-view<i>``.
    :param expert_ids: whose frames the reward is made with: for ``tcc`` their last ones are the
        goal, for ``tcc_ot`` they are the expert set.
    :param preset: features, statistics, dimension and, for ``tcc_ot``, transport.
    :param demonstrations: videos that are learnt from, where others have features too: from an
        expert set that was ranked nothing is learnt here. None: all.
    :raises RankingError: for fewer than two demonstrations, or experts without features.
    :raises ShapeError: if the features are not those of the preset.
    """
    started = time.monotonic()
    check_recipe(features, preset)
    if missing := [name for name in expert_ids if name not in features]:
        raise RankingError(f"{len(missing)} experts have no features, such as {missing[0]}")
    taught: Features = features
    if demonstrations is not None:
        wanted = set(demonstrations)
        taught = {n: features[n] for n in features if _original(n).removeprefix(MIRRORED) in wanted}
    embedder, losses = fit_tcc(taught, preset.dimension, preset, config, rng, on_epoch)
    encoder, report = tcc_encoder(
        features, embedder, losses, expert_ids, preset, config, rng, method, started
    )
    return encoder, replace(report, demonstrations=len(originals(taught)))


def tcc_encoder(
    features: FeatureStore,
    embedder: Embedder,
    losses: tuple[float, ...],
    expert_ids: Sequence[str],
    preset: Preset,
    config: TccConfig,
    rng: np.random.Generator,
    method: str,
    started: float,
    has_own_backbone: bool = False,
) -> tuple[Encoder, TccReport]:
    """Put the backbone in front, find the reward's scale, and report."""
    kind = get_method(method).reward
    card = card_for(method, features.extractor, embedder, preset, kind, expert_ids)
    card = replace(card, has_own_backbone=has_own_backbone)
    if kind == "goal":
        card = replace(card, expert_from=GOAL_FROM)
    plain = Encoder(features.extractor, embedder, card)
    names = originals(features)
    embeddings = {name: plain.embed_features(features[name]) for name in names}
    scaled = with_reward_scale(card, embeddings, rng)
    report = TccReport(
        method=method,
        preset=preset.name,
        demonstrations=len(names),
        iterations=config.iterations,
        first_loss=losses[0],
        last_loss=losses[-1],
        kendall_tau=mean_tau([embeddings[name] for name in names[:_MOST_IN_TAU]]),
        reward_scale=scaled.reward_scale,
        seconds=time.monotonic() - started,
    )
    return Encoder(features.extractor, embedder, scaled), report


def alignment_tau(z: NDArray[Any], other: NDArray[Any]) -> float:
    """Kendall's tau between the frames of one video and their nearest ones in another.

    :param z: (T, D).
    :param other: (S, D).
    :return: 1 when nearest neighbours follow the order of time; NaN when all are one frame.
    """
    squares = np.square(z[:, None, :] - other[None, :, :]).sum(-1)  # (T, S)
    return float(kendalltau(np.arange(len(z)), squares.argmin(1)).statistic)


def mean_tau(embeddings: Sequence[NDArray[Any]]) -> float:
    """The mean of :func:`alignment_tau` over ordered pairs of videos; NaN for fewer than two."""
    taus = [
        alignment_tau(a, b)
        for i, a in enumerate(embeddings)
        for j, b in enumerate(embeddings)
        if i != j
    ]
    known = [tau for tau in taus if not math.isnan(tau)]
    return float(np.mean(known)) if known else math.nan


def originals(features: Mapping[str, Any]) -> list[str]:
    """Names of the videos themselves, without changed copies."""
    return [name for name in features if _original(name) == name]


def _original(name: str) -> str:
    return name.partition(VIEW_MARK)[0]
