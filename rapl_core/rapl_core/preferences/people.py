"""What is made of several people's answers: groups with one wish, and how far to trust each."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from rapl_core.errors import RankingError, ShapeError
from rapl_core.preferences.agreement import agreement_table
from rapl_core.preferences.expert_set import expert_set
from rapl_core.preferences.groups import Groups, find_groups
from rapl_core.preferences.mistakes import MistakeEstimate, estimate_mistakes
from rapl_core.preferences.triplets import triplets_from
from rapl_core.preferences.video_features import VideoFeatures
from rapl_core.types import DoubtedTriplet, Noise, Ranking, Triplet

PEOPLE_FILE = "people.json"
"""In the run folder: what the last alignment found about the annotators, in plain words and by
group."""


@dataclass(frozen=True)
class PeopleConfig:
    """What to make of wrong answers and of people who disagree."""

    noise: Noise = "plain"
    """What is made of wrong answers. plain: nothing. smoothing: labels are softened by
    `smoothing_rate`. estimated: each annotator's rate of mistakes is estimated from how well all
    other answers predict theirs, and who errs more weighs less."""
    smoothing_rate: float = field(default=0.1, metadata={"minimum": 0.0, "maximum": 0.5})
    """Share of comparisons taken to be wrong by `smoothing`."""
    groups: int = field(default=1, metadata={"minimum": 0, "maximum": 4})
    """Representations to learn, one a group of annotators who want the same; 0: as many as the
    answers speak for."""

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing_rate <= 0.5:
            raise ShapeError(f"smoothing_rate is {self.smoothing_rate}, expected 0 to 0.5")


@dataclass(frozen=True)
class GroupLesson:
    """What one group of annotators teaches."""

    annotators: tuple[str, ...]
    rankings: tuple[Ranking, ...]
    triplets: tuple[Triplet, ...]
    """With the doubt about each annotator, unless noise is plain."""
    expert_ids: tuple[str, ...]
    mistakes: MistakeEstimate | None
    """None: not estimated."""


@dataclass(frozen=True)
class PeopleFindings:
    """How far people agree, and what was made of it."""

    lessons: tuple[GroupLesson, ...]
    """The group with the most rankings first."""
    agreement: float
    """Share of pairs that two annotators both ranked and ordered alike; NaN without any."""
    agreement_pairs: int
    groups: Groups | None
    """What the answers speak for; None where it was not looked for (one annotator)."""
    text: str
    """The same, in plain words."""

    def to_json(self) -> dict[str, Any]:
        """What the report shows; NaN becomes null."""
        return {
            "text": self.text,
            "agreement": _known(self.agreement),
            "agreement_pairs": self.agreement_pairs,
            "groups": [
                {
                    "annotators": list(lesson.annotators),
                    "rankings": len(lesson.rankings),
                    "mistakes": asdict(lesson.mistakes)["by_annotator"] if lesson.mistakes else {},
                }
                for lesson in self.lessons
            ],
        }


def study_people(
    rankings: Sequence[Ranking],
    features: VideoFeatures | None,
    config: PeopleConfig,
    experts: int,
    rng: np.random.Generator,
) -> PeopleFindings:
    """Find groups and mistakes, and say what is to be learnt from whom.

    :param rankings: those that count.
    :param features: of the ranked videos; None: nothing can be estimated.
    :param experts: videos in the expert set of each group, at most.
    :raises RankingError: if no ranking has an order, or something is to be estimated without
        features.
    """
    rankings = [ranking for ranking in rankings if ranking.ranks]
    if not rankings:
        raise RankingError("nobody has ranked anything yet")
    people = sorted({ranking.annotator for ranking in rankings})
    if features is None and (config.noise == "estimated" or config.groups != 1):
        raise RankingError("mistakes and groups cannot be estimated without features of the videos")
    groups = None
    if features is not None and len(people) > 1:
        groups = find_groups(features, rankings, rng, config.groups if config.groups > 1 else None)
    members = groups.members if groups and config.groups != 1 else (tuple(people),)
    lessons = tuple(
        _lesson(
            [r for r in rankings if r.annotator in names], names, features, config, experts, rng
        )
        for names in members
    )
    share = agreement_table(rankings).overall()
    text = _in_words(people, lessons, groups, share.value, share.pairs, config)
    return PeopleFindings(lessons, share.value, share.pairs, groups, text)


def _lesson(
    rankings: Sequence[Ranking],
    names: Sequence[str],
    features: VideoFeatures | None,
    config: PeopleConfig,
    experts: int,
    rng: np.random.Generator,
) -> GroupLesson:
    mistakes = None
    trust: Mapping[str, float] | None = None
    if config.noise == "estimated" and features is not None:
        mistakes = estimate_mistakes(features, rankings, rng)
        trust = _trust(mistakes, names)
    triplets: list[Triplet] = []
    for ranking in rankings:
        doubt = mistakes.of(ranking.annotator) if mistakes else config.smoothing_rate
        for t in triplets_from([ranking]):
            plain = config.noise == "plain"
            triplets.append(t if plain else DoubtedTriplet(t.best, t.middle, t.worst, doubt))
    ranked = {video for ranking in rankings for video in ranking.episode_ids}
    chosen = expert_set(rankings, min(experts, len(ranked)), trust)
    return GroupLesson(tuple(names), tuple(rankings), tuple(triplets), tuple(chosen), mistakes)


def _trust(mistakes: MistakeEstimate, names: Sequence[str]) -> dict[str, float]:
    """How much an answer of each counts, the most reliable 1: its information, to first order."""
    worth = {name: max((1 - 2 * mistakes.of(name)) ** 2, 1e-3) for name in names}
    most = max(worth.values())
    return {name: value / most for name, value in worth.items()}


def _in_words(
    people: Sequence[str],
    lessons: Sequence[GroupLesson],
    groups: Groups | None,
    agreement: float,
    pairs: int,
    config: PeopleConfig,
) -> str:
    said = [f"{len(people)} annotators." if len(people) > 1 else f"One annotator, {people[0]}."]
    if pairs:
        said.append(
            f"Where two of them ranked the same two videos, they agreed on {agreement:.0%} of "
            f"{pairs} pairs."
        )
    if groups and groups.count > 1:
        listed = " | ".join(_names(names) for names in groups.members)
        gain = groups.held_out_accuracy
        said.append(
            f"People disagree: {groups.count} groups ({listed}). What one group wants orders "
            f"{groups.cross_agreement:.0%} of another's comparisons as they did; one utility for "
            f"all orders {gain[0]:.0%} of held-out comparisons right, {groups.count} order "
            f"{gain[groups.count - 1]:.0%}."
        )
        said.append(
            "Each group has a representation of its own; the robot learns from that of the first, "
            "which gave most of the rankings or as many as any other."
            if config.groups != 1
            else "One representation was learnt from all of them, which can please neither; "
            "groups 0 learns one for each."
        )
    elif groups:
        said.append("Nothing in the answers speaks for groups who want different things.")
    for lesson in lessons:
        if lesson.mistakes and not math.isnan(lesson.mistakes.accuracy):
            worst = sorted(lesson.mistakes.by_annotator.items(), key=lambda item: -item[1])[:3]
            rates = ", ".join(f"{name} {rate:.0%}" for name, rate in worst)
            whose = f" of {_names(lesson.annotators)}" if len(lessons) > 1 else ""
            said.append(
                f"Estimated share of wrong comparisons{whose}: {lesson.mistakes.rate:.0%} "
                f"(most: {rates}); who errs more weighs less."
            )
        elif lesson.mistakes:
            said.append("Too few comparisons to estimate how many are wrong.")
    if config.noise == "smoothing":
        said.append(f"{config.smoothing_rate:.0%} of the comparisons are taken to be wrong.")
    return " ".join(said)


def _names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown} and {len(names) - 6} more"


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
