"""The steps that every method of learning from rankings takes, around its own objective."""

import hashlib
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import RankingError, ShapeError
from rapl_core.representations.card import EncoderCard
from rapl_core.representations.encoder import Encoder, matched_part, reward_of
from rapl_core.representations.extractor import FeatureExtractor
from rapl_core.representations.features import MIRRORED, FeatureStore, stack_frames
from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.inferred import inferred_triplets
from rapl_core.representations.presets import Preset
from rapl_core.representations.projection import Projection
from rapl_core.representations.report import AlignmentReport, wilson_interval
from rapl_core.representations.reward_scale import fit_reward_scale
from rapl_core.representations.split import TripletSplit, split_triplets
from rapl_core.representations.training import (
    EpochProgress,
    Features,
    History,
    Objective,
    TiedTriplet,
    TrainingData,
    train_head,
)
from rapl_core.transport.plain_rewards import RewardKind
from rapl_core.types import EmbeddedEpisode, Triplet

OnEpoch = Callable[[EpochProgress], None]

Ranked = TypeVar("Ranked", Triplet, TiedTriplet)


@dataclass(frozen=True)
class Lesson:
    """What an encoder is to learn from."""

    triplets: Sequence[Triplet]
    expert_ids: Sequence[str]
    """D+, the most preferred videos."""
    ties: Sequence[TiedTriplet] = ()
    held_out: Sequence[Triplet] | None = None
    """None: a share of the triplets, chosen at random."""

    def check(self, features: Features) -> None:
        """
        :raises RankingError: if a video has no features, or there is no expert or triplet.
        """
        if not self.triplets:
            raise RankingError("no triplet to learn from, expected at least one")
        if not self.expert_ids:
            raise RankingError("no expert video, expected at least one")
        named = [*self.expert_ids]
        for triplet in (*self.triplets, *(self.held_out or ())):
            named += [triplet.best, triplet.middle, triplet.worst]
        for tie in self.ties:
            named += [tie.best, tie.first, tie.second]
        if missing := sorted(set(named) - set(features)):
            raise RankingError(
                f"{len(missing)} of the ranked videos have no features, such as {missing[0]}; "
                f"{len(features)} videos have"
            )

    def sha256(self, extractor_version: str) -> str:
        """Of everything in it and the features."""
        held_out = None if self.held_out is None else list(self.held_out)
        parts = (list(self.triplets), list(self.expert_ids), list(self.ties), held_out)
        return hashlib.sha256(repr((parts, extractor_version)).encode()).hexdigest()


@dataclass(frozen=True)
class Fit:
    """A trained embedder, still without the backbone in front of it."""

    embedder: Embedder
    split: TripletSplit
    history: History
    statistics_videos: tuple[str, ...]
    explained_variance: float

    def embed(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        """(T, F) -> (T, D)."""
        with torch.inference_mode():
            return np.array(self.embedder(torch.from_numpy(features)).numpy())


def fit_embedder(
    features: Features,
    lesson: Lesson,
    objective: Objective,
    dimension: int,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> Fit:
    """Learn statistics, components and head from any per-video features.

    Statistics come from every video of ``features`` but those that only held-out triplets show.

    :param features: (T, F) by episode id, from training videos only.
    :param dimension: D of the head.
    :raises RankingError: if the lesson is empty or names videos without features.
    """
    lesson.check(features)
    if lesson.held_out is None:
        split = split_triplets(lesson.triplets, preset.held_out, rng, preset.disjoint_videos)
    else:
        split = TripletSplit(tuple(lesson.triplets), tuple(lesson.held_out))
    unseen = split.unseen_videos - set(lesson.expert_ids)
    statistics_videos = tuple(
        name for name in sorted(features) if name.removeprefix(MIRRORED) not in unseen
    )
    projection = fit_projection({n: features[n] for n in statistics_videos}, preset, rng)
    width = next(iter(features.values())).shape[1]
    head = linear_head(projection.dimension if projection else width, dimension, rng)
    inferred = inferred_triplets(split.train, round(preset.inferred * len(split.train)), rng)
    taught = replace(split, train=(*split.train, *inferred))
    names = used_videos(taught, lesson, _has_twins(features, preset))
    videos = {name: project(projection, features[name]) for name in names}
    data = training_data(videos, lesson, taught, preset)
    history = train_head(head, objective, data, preset, rng, on_epoch)
    explained = projection.explained if projection else 1.0
    return Fit(Embedder(projection, head), split, history, statistics_videos, explained)


def build_encoder(
    method: str,
    features: FeatureStore,
    lesson: Lesson,
    fit: Fit,
    preset: Preset,
    reward_kind: RewardKind,
    rng: np.random.Generator,
    started: float,
    has_own_backbone: bool = False,
) -> tuple[Encoder, AlignmentReport]:
    """Put the backbone in front of a fit, find the reward's scale, and report.

    :param started: ``time.monotonic()`` when the alignment began.
    :param has_own_backbone: whether the backbone was trained here and belongs into a checkpoint.
    """
    extractor = features.extractor
    card = card_for(method, extractor, fit.embedder, preset, reward_kind, lesson.expert_ids)
    card = replace(
        card,
        data_sha256=lesson.sha256(extractor.version),
        has_own_backbone=has_own_backbone,
    )
    embeddings = {name: fit.embed(features[name]) for name in fit.statistics_videos}
    card = with_reward_scale(card, embeddings, rng)
    best = fit.history.epochs[fit.history.best_epoch - 1] if fit.history.best_epoch else None
    accuracy = best.held_out_accuracy if best else math.nan
    held_out = len(fit.split.held_out)
    report = AlignmentReport(
        method=method,
        preset=preset.name,
        train_triplets=len(fit.split.train),
        held_out_triplets=held_out,
        dropped_triplets=len(fit.split.dropped),
        tied_triplets=len(lesson.ties),
        held_out_accuracy=accuracy,
        held_out_interval=wilson_interval(0.5 if math.isnan(accuracy) else accuracy, held_out),
        statistics_videos=len(fit.statistics_videos),
        explained_variance=fit.explained_variance,
        reward_scale=card.reward_scale,
        best_epoch=fit.history.best_epoch,
        history=fit.history.epochs,
        seconds=time.monotonic() - started,
    )
    return Encoder(extractor, fit.embedder, card), report


def card_for(
    method: str,
    extractor: FeatureExtractor,
    embedder: Embedder,
    preset: Preset,
    reward_kind: RewardKind,
    expert_ids: Iterable[str],
) -> EncoderCard:
    """The card of an encoder at reward scale 1 and without a data hash."""
    projection, head = embedder.projection, embedder.head
    width = projection.dimension if projection else extractor.dimension
    return EncoderCard(
        method=method,
        preset=preset.name,
        backbone=extractor.backbone.spec.name,
        backbone_sha256=extractor.backbone.weights_sha256,
        recipe=extractor.recipe,
        preprocessing=extractor.preprocessing,
        features=extractor.dimension,
        components=projection.components.shape[1] or None if projection else None,
        has_projection=projection is not None,
        has_head=head is not None,
        dimension=head.out_features if head else width,
        reward_kind=reward_kind,
        transport=preset.reward,
        reward_scale=1.0,
        expert_ids=tuple(expert_ids),
        expert_from=preset.expert_from,
        data_sha256="",
        weights_file=extractor.backbone.weights_file,
    )


def with_reward_scale(
    card: EncoderCard, embeddings: Mapping[str, NDArray[np.float32]], rng: np.random.Generator
) -> EncoderCard:
    """The card with the scale that :func:`fit_reward_scale` finds on training videos."""
    experts = [
        EmbeddedEpisode(name, matched_part(embeddings[name], card.expert_from))
        for name in card.expert_ids
        if name in embeddings
    ]
    unscaled = replace(card, reward_scale=1.0)
    scale = fit_reward_scale(embeddings, lambda z: reward_of(unscaled, z, experts), rng)
    return replace(card, reward_scale=scale)


def check_recipe(features: FeatureStore, preset: Preset) -> None:
    """
    :raises ShapeError: if the features were not read from the backbone as the preset wants.
    """
    if features.extractor.recipe != preset.recipe:
        raise ShapeError(
            f"features were extracted with {asdict(features.extractor.recipe)}, "
            f"preset {preset.name} expects {asdict(preset.recipe)}"
        )
    if features.mirror != preset.mirror:
        raise ShapeError(
            f"features were read {'with' if features.mirror else 'without'} mirrored twins, preset "
            f"{preset.name} expects mirror={preset.mirror}"
        )


def fit_projection(
    features: Features, preset: Preset, rng: np.random.Generator
) -> Projection | None:
    """Statistics and components of all videos of ``features``; None where the preset has none."""
    if not preset.has_projection:
        return None
    frames = stack_frames(features)
    count = None if preset.components is None else min(preset.components, *frames.shape)
    projection = Projection(frames.shape[1], count)
    projection.fit(frames, rng)
    return projection


def project(projection: Projection | None, video: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, F) -> (T, K)."""
    if projection is None:
        return video
    with torch.no_grad():
        return np.asarray(projection(torch.from_numpy(video)).numpy())


def training_data(
    videos: Mapping[str, NDArray[Any]], lesson: Lesson, split: TripletSplit, preset: Preset
) -> TrainingData:
    """The triplets of a split over what a head takes of each video.

    :param videos: (T, ...) of :func:`used_videos`; what is learnt from also mirrored, where the
        preset wants it and there are mirrored twins.
    """
    train, ties, experts = list(split.train), list(lesson.ties), list(lesson.expert_ids)
    if _has_twins(videos, preset):
        train += [_twin(triplet, ("best", "middle", "worst")) for triplet in split.train]
        ties += [_twin(tie, ("best", "first", "second")) for tie in lesson.ties]
        experts += [MIRRORED + name for name in lesson.expert_ids]
    return TrainingData(
        videos, train, split.held_out, experts, ties, preset.frames, preset.expert_from
    )


def used_videos(split: TripletSplit, lesson: Lesson, with_twins: bool = False) -> list[str]:
    """Names of the videos that a training refers to, in order.

    :param with_twins: also of the mirrored twins of those that are learnt from.
    """
    learnt = _named(split.train, lesson)
    twins = {MIRRORED + name for name in learnt} if with_twins else set()
    return sorted(learnt | twins | _named(split.held_out, lesson))


def _has_twins(videos: Mapping[str, Any], preset: Preset) -> bool:
    return preset.mirror and any(name.startswith(MIRRORED) for name in videos)


def _twin(ranked: Ranked, names: Sequence[str]) -> Ranked:
    """The same order of the mirrored videos."""
    return replace(ranked, **{field: MIRRORED + getattr(ranked, field) for field in names})


def _named(triplets: Iterable[Triplet], lesson: Lesson) -> set[str]:
    names = {name for t in triplets for name in (t.best, t.middle, t.worst)}
    names |= {name for t in lesson.ties for name in (t.best, t.first, t.second)}
    return names | set(lesson.expert_ids)
