"""RAPL and RLHF with the backbone's last block: it learns together with the head, from rankings.

The paper trains the last layer only. Here that comes first, as there; then block and head learn on
from it (linear probing, then fine-tuning: Kumar et al. 2022), with the same objective and the same
held-out triplets, and stay as they were if no epoch orders those better. Each video is shown at a
few frames: what is cached for a head alone has to be computed in every step here.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.alignment import (
    Fit,
    Lesson,
    OnEpoch,
    build_encoder,
    check_recipe,
    training_data,
    used_videos,
)
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.features import MIRRORED, FeatureStore
from rapl_core.representations.heads import Embedder
from rapl_core.representations.methods import get_method
from rapl_core.representations.presets import Preset
from rapl_core.representations.rapl import RaplObjective, fit_rapl
from rapl_core.representations.report import AlignmentReport
from rapl_core.representations.rlhf import RlhfObjective, fit_rlhf, zero_at_experts
from rapl_core.representations.trainable import TrainableBackbone
from rapl_core.representations.training import EpochProgress, History, Objective, train_head

FramesOf = Callable[[str], NDArray[np.uint8]]
"""A video's frames 1..T, (T, H, W, 3)."""

METHODS = ("rapl", "rlhf")

_SCALE_VIDEOS = 64
"""Training videos at most that the reward's scale is fitted to."""


@dataclass(frozen=True)
class BlockConfig:
    """How block and head learn on; what is not here is the preset's."""

    epochs: int = 10
    """Beside those of the head alone."""
    frames: int = 10
    """Of each video at most, evenly spread; the head alone learns from the same."""
    learning_rate: float = 1e-4
    """Of the block."""
    head_rate: float = 0.1
    """Of the head, as a share of the preset's: it has learnt already."""
    slow_pairs: int = 64
    """A batch, for presets with a ``slow_weight``."""

    def __post_init__(self) -> None:
        for name in ("epochs", "slow_pairs"):
            if getattr(self, name) < 1:
                raise ShapeError(f"BlockConfig.{name} is {getattr(self, name)}, expected 1 or more")
        if self.frames < 2:
            raise ShapeError(f"BlockConfig.frames is {self.frames}, expected 2 or more")
        for name in ("learning_rate", "head_rate"):
            if not getattr(self, name) > 0:
                raise ShapeError(f"BlockConfig.{name} is {getattr(self, name)}, expected above 0")


class BlockAndHead(nn.Module):
    """What is trained: from the backbone's trunk, or pictures, to embeddings."""

    def __init__(self, backbone: TrainableBackbone, embedder: Embedder) -> None:
        super().__init__()
        self.backbone = backbone
        self.embedder = embedder

    def forward(self, start: torch.Tensor) -> torch.Tensor:
        """(N, ...) of :meth:`TrainableBackbone.trunk` -> (N, D)."""
        z: torch.Tensor = self.embedder(self.backbone.tail(start))
        return z


def learn_block(
    method: str,
    features: FeatureStore,
    frames_of: FramesOf,
    lesson: Lesson,
    preset: Preset,
    config: BlockConfig,
    rng: np.random.Generator,
    folder: Path,
    weights: Path | None = None,
    on_epoch: OnEpoch | None = None,
) -> tuple[Encoder, AlignmentReport]:
    """Learn head and last block from rankings.

    The report's epochs are those of the head alone and then those of both; its accuracy is that
    of the epoch that was kept, on the few frames of each video.

    :param method: ``rapl`` or ``rlhf``.
    :param features: of the backbone as it is given, of training videos only.
    :param frames_of: the pictures of a video of ``features``.
    :param folder: gets the backbone's new weights.
    :param weights: those that ``features`` were read with; None: the default place.
    :raises UnknownNameError: for another method, or a network without a block to train.
    :raises RankingError: if there is no triplet or expert, or a video has no features.
    :raises ShapeError: if the features are not those of the preset.
    """
    if method not in METHODS:
        raise UnknownNameError("method that learns from rankings", method, METHODS)
    started = time.monotonic()
    check_recipe(features, preset)
    backbone = TrainableBackbone(features.extractor, weights)
    few = replace(preset, frames=min(config.frames, preset.frames or config.frames))
    totals = _counted(on_epoch, 0, preset.epochs + config.epochs)
    objective: Objective
    if method == "rapl":
        objective, fit = RaplObjective(few), fit_rapl(features, lesson, few, rng, totals)
    else:
        objective = RlhfObjective(few.noise)
        fit = fit_rlhf(features, lesson, few, rng, totals)
    fit = _learn_on(
        fit, backbone, objective, features, frames_of, lesson, few, config, rng, on_epoch
    )
    store = FeatureStore(backbone.trained(folder), precision=features.precision)
    taught = [name for name in fit.statistics_videos if not name.startswith(MIRRORED)]
    drawn = rng.choice(len(taught), min(_SCALE_VIDEOS, len(taught)), replace=False)
    for name in sorted({*(taught[i] for i in drawn), *lesson.expert_ids}):
        store.add(name, frames_of(name))
    if method == "rlhf":
        zero_at_experts(fit, store, lesson)
    looked_at = replace(fit, statistics_videos=tuple(store))
    kind = get_method(method).reward
    encoder, report = build_encoder(
        method, store, lesson, looked_at, preset, kind, rng, started, has_own_backbone=True
    )
    return encoder, replace(report, statistics_videos=len(fit.statistics_videos))


def _learn_on(
    fit: Fit,
    backbone: TrainableBackbone,
    objective: Objective,
    features: FeatureStore,
    frames_of: FramesOf,
    lesson: Lesson,
    preset: Preset,
    config: BlockConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None,
) -> Fit:
    """Train block and head from where the head alone came to; the triplets that were asked."""
    assert preset.frames is not None
    whole = BlockAndHead(backbone, fit.embedder)
    starts = {
        name: backbone.trunk(_shown(frames_of, name, preset.frames))
        for name in used_videos(fit.split, lesson, features.mirror)
    }
    before = fit.history
    learns_on = replace(preset, epochs=config.epochs)
    groups: list[dict[str, Any]] = [
        {"params": fit.embedder.parameters(), "lr": config.head_rate * preset.learning_rate},
        {"params": backbone.free_parameters(), "lr": config.learning_rate, "weight_decay": 0.0},
    ]
    history = train_head(
        whole,
        objective,
        training_data(starts, lesson, fit.split, preset),
        learns_on,
        rng,
        _counted(on_epoch, len(before.epochs), len(before.epochs) + config.epochs),
        groups,
        config.slow_pairs,
        goes_on=True,
    )
    return replace(fit, history=_joined(before, history))


def _shown(frames_of: FramesOf, name: str, count: int) -> NDArray[np.uint8]:
    """``count`` frames of a video, evenly spread; mirrored if the name says so."""
    frames = frames_of(name.removeprefix(MIRRORED))
    chosen = frames[np.linspace(0, len(frames) - 1, count).round().astype(int)]
    if name.startswith(MIRRORED):
        chosen = chosen[:, :, ::-1]
    return np.ascontiguousarray(chosen)


def _counted(on_epoch: OnEpoch | None, done: int, total: int) -> OnEpoch | None:
    """Tell of epochs as parts of the whole."""
    if on_epoch is None:
        return None
    told = on_epoch

    def tell(progress: EpochProgress) -> None:
        told(replace(progress, epoch=done + progress.epoch, epochs=total))

    return tell


def _joined(head: History, block: History) -> History:
    """One history; the head's best epoch stands where the block made nothing better."""
    done = len(head.epochs)
    total = done + len(block.epochs)
    epochs = [replace(e, epochs=total) for e in head.epochs]
    epochs += [replace(e, epoch=done + e.epoch, epochs=total) for e in block.epochs]
    best = done + block.best_epoch if block.best_epoch else head.best_epoch
    return History(tuple(epochs), best)
