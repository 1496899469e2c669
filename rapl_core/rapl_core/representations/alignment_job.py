"""From the rankings of a run to an encoder on disk: the long work behind the action
``preference/align`` and the command ``rapl encoders train``."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rapl_core.atomic import write_atomically
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RankingError
from rapl_core.preferences import RankingStore, triplets_from
from rapl_core.preferences.own_videos import videos_to_learn_from
from rapl_core.preferences.people import (
    PEOPLE_FILE,
    GroupLesson,
    PeopleConfig,
    PeopleFindings,
    study_people,
)
from rapl_core.preferences.store import RANKINGS_FILE
from rapl_core.preferences.video_features import summarise
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.checkpoints import checkpoint_folder, save_encoder
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.engines import Engine
from rapl_core.representations.extractor import FeatureRecipe, Precision, make_extractor
from rapl_core.representations.features import MIRRORED, FeatureStore, prepare_extractor
from rapl_core.representations.masked import MaskedConfig
from rapl_core.representations.methods import DEFAULT_BACKBONE, Trained, get_method
from rapl_core.representations.presets import Preset, get_preset
from rapl_core.representations.ranking_block import BlockConfig, learn_block
from rapl_core.representations.rapl import align
from rapl_core.representations.report import AlignmentReport
from rapl_core.representations.rlhf import learn_reward
from rapl_core.representations.tcc import TccConfig
from rapl_core.representations.training import EpochProgress, TiedTriplet
from rapl_core.representations.workshop import Workshop, WorkshopConfig
from rapl_core.types import Ranking

LEARNT_FROM = "learnt_from"
"""In a checkpoint's report: ``annotators``, ``rankings`` (ids) and the ``videos`` in them."""


@dataclass(frozen=True)
class AlignmentOrder:
    """What is to be made."""

    run_folder: Path
    method: str
    preset: str = "tuned"
    rankings: int = 0
    """The first so many; 0: all."""
    seed: int = 0
    experts: int = 10
    """Videos in the expert set, the most preferred by the rankings alone."""
    precision: Precision = "bfloat16"
    purposes: tuple[str, ...] = ("demonstrate",)
    """Purposes of the episodes that are the pool of videos."""
    people: PeopleConfig = PeopleConfig()
    """What to make of wrong answers and of people who disagree."""
    backbone: str = ""
    """Network that features are read from; empty: the one that the method names."""
    weights: Path | None = None
    """Its weights, a file or a folder; None: the default place."""
    engine: Engine = "torch"
    """What computes the features of frozen networks."""
    trained: Trained = "head"
    """What learns from rankings; for what learns from demonstrations see ``tcc``."""
    block: BlockConfig = field(default_factory=BlockConfig)
    tcc: TccConfig = field(default_factory=TccConfig)
    masked: MaskedConfig = field(default_factory=MaskedConfig)

    @property
    def workshop(self) -> WorkshopConfig:
        """What makes the encoders that learn from no rankings."""
        return WorkshopConfig(
            self.run_folder, self.method, self.preset, self.seed, self.precision, self.purposes,
            self.backbone, self.weights, self.engine, self.tcc, self.masked,
        )  # fmt: skip


@dataclass(frozen=True)
class GroupOutcome:
    """The encoder of one group of annotators."""

    lesson: GroupLesson
    version: str
    uri: str
    """Relative to the run folder."""
    held_out_accuracy: float
    """NaN where nothing was learnt from triplets."""
    held_out_triplets: int = 0
    held_out_interval: tuple[float, float] = (0.0, 1.0)
    """95 % interval of the accuracy."""

    @property
    def mistakes(self) -> float:
        """Estimated share of wrong comparisons; NaN: not estimated."""
        return self.lesson.mistakes.rate if self.lesson.mistakes else math.nan


@dataclass(frozen=True)
class AlignmentOutcome:
    """What was made."""

    groups: tuple[GroupOutcome, ...]
    """The one with the most rankings first: that one is put to work."""
    triplets: int
    findings: str
    """How far people agree and what was made of it."""


def run_alignment(
    order: AlignmentOrder,
    on_video: Callable[[int, int], None],
    on_epoch: Callable[[EpochProgress], None],
) -> AlignmentOutcome:
    """Read features, learn, write the encoder to ``encoders/<method>-<version>``.

    :param on_video: told how many videos of how many are read; what it raises ends the work.
    :param on_epoch: the same for epochs.
    :raises UnknownNameError: for another method or preset, naming the known ones.
    :raises RankingError: if there are too few rankings.
    :raises WeightsError: if the backbone's weights cannot be had.
    """
    method = get_method(order.method)
    workshop = Workshop(order.workshop, on_video, on_epoch)
    preset = get_preset(order.preset)
    rankings = _rankings(order)
    triplets = triplets_from(rankings)
    if not triplets:
        raise RankingError(f"no triplet in {len(rankings)} rankings, expected at least one")
    rng = np.random.default_rng(order.seed)
    several = len({ranking.annotator for ranking in rankings}) > 1
    looks = several or order.people.noise == "estimated" or order.people.groups != 1
    features: FeatureStore | None = None
    if looks or method.lesson == "rankings":
        features = _features(order, preset.recipe, preset.mirror, rankings, on_video)
    summary = None
    if looks and features is not None:
        summary = summarise({n: features[n] for n in features if not n.startswith(MIRRORED)})
    # A generator of its own: who ranked must not change what one person's rankings lead to.
    people_rng = np.random.default_rng([order.seed, 301])
    people = study_people(rankings, summary, order.people, order.experts, people_rng)
    preset = replace(preset, noise=order.people.noise)
    # The largest group last: its encoder is the newest, which the method's name stands for.
    outcomes = [
        _learn(order, lesson, workshop, features, preset, rng, on_epoch)
        for lesson in reversed(people.lessons)
    ]
    _write_findings(order.run_folder, people, outcomes)
    return AlignmentOutcome(tuple(reversed(outcomes)), len(triplets), people.text)


def _learn(
    order: AlignmentOrder,
    lesson: GroupLesson,
    workshop: Workshop,
    features: FeatureStore | None,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: Callable[[EpochProgress], None],
) -> GroupOutcome:
    encoder: Encoder
    report: dict[str, Any] = {}
    learnt: AlignmentReport | None = None
    experts = lesson.expert_ids
    if not lesson.triplets:
        raise RankingError(
            f"no triplet in {len(lesson.rankings)} rankings of {', '.join(lesson.annotators)}"
        )
    if workshop.method.lesson != "rankings" or features is None:
        product = workshop.make(experts, rng)
        encoder, report = product.encoder, product.report or {"method": order.method}
    else:
        encoder, learnt = _learn_from_rankings(order, lesson, features, preset, rng, on_epoch)
        report = learnt.to_json()
    folder = checkpoint_folder(order.run_folder, encoder)
    save_encoder(encoder, folder, {**report, LEARNT_FROM: _sources(lesson)})
    return GroupOutcome(
        lesson,
        version=encoder.info.version,
        uri=str(folder.relative_to(order.run_folder)),
        held_out_accuracy=learnt.held_out_accuracy if learnt else math.nan,
        held_out_triplets=learnt.held_out_triplets if learnt else 0,
        held_out_interval=learnt.held_out_interval if learnt else (0.0, 1.0),
    )


def _sources(lesson: GroupLesson) -> dict[str, Any]:
    """Whose rankings, and which: so that others can be told from them later."""
    return {
        "annotators": list(lesson.annotators),
        "rankings": [ranking.ranking_id for ranking in lesson.rankings],
        "videos": sorted({name for r in lesson.rankings for name in r.episode_ids}),
    }


def _learn_from_rankings(
    order: AlignmentOrder,
    lesson: GroupLesson,
    features: FeatureStore,
    preset: Preset,
    rng: np.random.Generator,
    on_epoch: Callable[[EpochProgress], None],
) -> tuple[Encoder, AlignmentReport]:
    triplets, experts = lesson.triplets, lesson.expert_ids
    ties = tied_triplets(lesson.rankings) if order.method == "rapl" else []
    if order.trained == "last_block":
        episodes = EpisodeStore(order.run_folder / "episodes")
        return learn_block(
            order.method, features, lambda name: episodes.frames(name)[1:],
            Lesson(triplets, experts, ties), preset, order.block, rng,
            order.run_folder / "backbones", order.weights, on_epoch,
        )  # fmt: skip
    if order.method == "rlhf":
        return learn_reward(features, triplets, experts, preset, rng, on_epoch)
    return align(features, triplets, experts, preset, rng, on_epoch, ties)


def _write_findings(folder: Path, people: PeopleFindings, outcomes: Sequence[GroupOutcome]) -> None:
    """Write what the report says of the people; atomic."""
    found = people.to_json()
    for group, outcome in zip(found["groups"], reversed(outcomes), strict=True):
        group["encoder"] = outcome.uri
    write_atomically(folder / PEOPLE_FILE, json.dumps(found, indent=1, ensure_ascii=False) + "\n")


def tied_triplets(rankings: Sequence[Ranking]) -> list[TiedTriplet]:
    """Rankings of three in which one video is best and the other two are equal."""
    tied = []
    for ranking in rankings:
        by_rank = sorted(zip(ranking.ranks, ranking.episode_ids, strict=False))
        if len(by_rank) == 3 and by_rank[0][0] < by_rank[1][0] == by_rank[2][0]:
            tied.append(TiedTriplet(*(episode_id for _, episode_id in by_rank)))
    return tied


def _rankings(order: AlignmentOrder) -> list[Ranking]:
    path = order.run_folder / RANKINGS_FILE
    if not path.is_file():
        raise RankingError(f"{order.run_folder} has no {RANKINGS_FILE}: there is nothing to learn")
    with RankingStore(path) as store:
        rankings = [ranking for ranking in store.effective() if ranking.ranks]
    return rankings[: order.rankings] if order.rankings else rankings


def _features(
    order: AlignmentOrder,
    recipe: FeatureRecipe,
    mirror: bool,
    rankings: Sequence[Ranking],
    on_video: Callable[[int, int], None],
) -> FeatureStore:
    """Features of every video of the pool, for those in no triplet serve the statistics, and of
    the learner's own videos that were ranked.

    Parts are found in the pool alone, so that an encoder that is aligned again reads the same
    features: what the backbone gave for thousands of frames stays valid.
    """
    episodes = EpisodeStore(order.run_folder / "episodes")
    pool = [e.episode_id for e in episodes.summaries() if e.purpose in order.purposes]
    extractor = make_extractor(order.backbone or DEFAULT_BACKBONE, recipe, order.weights)
    # a block that learns reads its own maps, by torch; so its head's statistics are torch's too
    engine: Engine = order.engine if order.trained == "head" else "torch"
    prepare_extractor(extractor, pool, lambda name: episodes.frames(name)[1:], order.seed, engine)
    features = FeatureStore(
        extractor, order.run_folder / "features", order.precision, mirror=mirror
    )
    videos = videos_to_learn_from(pool, rankings)
    for done, episode_id in enumerate(videos):
        on_video(done, len(videos))
        features.add(episode_id, episodes.frames(episode_id)[1:])
    on_video(len(videos), len(videos))
    return features
