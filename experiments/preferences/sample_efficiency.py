"""How many rankings RAPL needs, by who is asked what, and what wrong or opposite answers cost.

    python experiments/preferences/sample_efficiency.py --seeds 9 10 11 12 13
    python experiments/preferences/summarise.py

Everything is learnt from a pool of 300 videos of franka_group with one preset and judged on 100
videos that nobody was asked about (``data.py``). Three studies, each kept as it is done, so that an
interrupted call goes on:

- ``strategies``: each strategy against uniform at 10 to 150 answers of a human who never errs;
- ``noise``: 150 uniform answers of which 10, 20 or 30 % are another order at random, plain,
  smoothed and with estimated rates; and three annotators of whom one never errs and one errs at
  60 %;
- ``groups``: four annotators, two of whom want the opposite: one representation, or one a group.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from data import Videos, load
from scipy.stats import spearmanr

from rapl_core.analysis import measures
from rapl_core.analysis.provenance import commit, machine
from rapl_core.preferences import (
    ContestQueries,
    HumanKnobs,
    SimulatedHuman,
    UniformQueries,
    expert_set,
    triplets_from,
)
from rapl_core.preferences.people import GroupLesson, PeopleConfig, study_people
from rapl_core.preferences.queries import QuerySelector
from rapl_core.preferences.strategies import LEARNING, make_selector
from rapl_core.preferences.video_features import VideoFeatures, summarise
from rapl_core.representations import Preset, get_preset
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.encoder import matched_part
from rapl_core.representations.query_ensemble import TransportEnsemble
from rapl_core.representations.rapl import fit_rapl
from rapl_core.transport import ot_reward
from rapl_core.types import EmbeddedEpisode, Noise, Ranking, Triplet

HERE = Path(__file__).parent
BUDGETS = (10, 25, 50, 100, 150)
UPDATE_EVERY = 10
"""Answers between two updates of a strategy's model."""
RATES = (0.1, 0.2, 0.3)
NOISES: tuple[Noise, ...] = ("plain", "smoothing", "estimated")
UNEVEN = {"good": 0.0, "middling": 0.3, "bad": 0.6}
WISHES = {"ann": "task", "ben": "task", "cyd": "opposite", "dot": "opposite"}
TEST_TRIPLETS = 1000
EXPERTS = 10
CARELESS = HumanKnobs(mistake_kind="any")

KEYS = ("study", "seed", "preset", "strategy", "budget", "wrong", "noise", "learnt")
"""What tells one result from another."""

Unit = dict[str, Any]


class Seed:
    """The videos of one seed and what is learnt from answers about them."""

    def __init__(self, seed: int, preset: Preset, work: Path) -> None:
        self.seed, self.preset = seed, preset
        self.pool, self.test = load(seed, preset, work, ("task", "opposite"))
        self.summary: VideoFeatures = summarise(self.pool.originals)

    def rng(self, *more: int) -> np.random.Generator:
        """Of one study, whatever was done before."""
        return np.random.default_rng([self.seed, *more])

    def ask(
        self,
        selector: QuerySelector,
        human: Callable[[int], tuple[str, str, SimulatedHuman]],
        count: int,
        after: Callable[[Sequence[Ranking]], None] = lambda rankings: None,
    ) -> list[Ranking]:
        """Answers to ``count`` queries.

        :param human: name, wish and person who gives answer number n.
        :param after: called after each answer.
        """
        rankings: list[Ranking] = []
        asked: list[tuple[str, ...]] = []
        names = sorted(self.pool.originals)
        for number in range(count):
            if number % UPDATE_EVERY == 0 and hasattr(selector, "update"):
                selector.update(rankings, asked)
            asked.append(selector.next(names, asked))
            name, wish, person = human(number)
            returns = self.pool.returns(wish)
            ranks = person.rank([returns[video] for video in asked[-1]])
            rankings.append(Ranking(f"{name}-{number}", name, asked[-1], ranks))
            after(rankings)
        return rankings

    def judge(
        self,
        triplets: Sequence[Triplet],
        experts: Sequence[str],
        noise: Noise = "plain",
        wishes: Iterable[str] = ("task",),
    ) -> dict[str, dict[str, float]]:
        """Learn from triplets and hold the reward against each wish on the test videos."""
        preset = replace(self.preset, noise=noise)
        fit = fit_rapl(self.pool.features, Lesson(triplets, experts), preset, self.rng(7))
        embedded = [
            EmbeddedEpisode(n, matched_part(fit.embed(self.pool.features[n]), preset.expert_from))
            for n in experts
        ]
        rewards = {
            name: ot_reward(fit.embed(video), embedded, preset.reward, 1.0).values
            for name, video in self.test.features.items()
        }
        return {wish: _measure(rewards, self.test, wish, self.rng(8)) for wish in wishes}


def _measure(
    rewards: dict[str, Any], test: Videos, wish: str, rng: np.random.Generator
) -> dict[str, float]:
    names = sorted(rewards)
    totals = np.array([rewards[name].sum() for name in names])
    truth = np.array([test.returns(wish)[name] for name in names])
    step = measures.spearman_per_step(
        [rewards[name] for name in names], [test.rewards[wish][name] for name in names]
    )
    right = []
    for _ in range(TEST_TRIPLETS):
        three = rng.choice(len(names), 3, replace=False)
        right.append(np.array_equal(np.argsort(-totals[three]), np.argsort(-truth[three])))
    return {
        "triplets": float(np.mean(right)),
        "episode": float(spearmanr(totals, truth).statistic),
        "step": float(step.mean),
    }


@dataclass
class Contest:
    """The contest as it stands after each answer, for so many in all."""

    rng: np.random.Generator
    wanted: int
    rankings: Sequence[Ranking] = ()

    def update(self, rankings: Sequence[Ranking], asked: Iterable[Iterable[str]] = ()) -> None:
        """Take the list to which every answer is added."""
        self.rankings = rankings

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """The next query."""
        return ContestQueries(self.rng, self.rankings, self.wanted).next(episode_ids, asked)


def _selector(seed: Seed, strategy: str, wanted: int, rng: np.random.Generator) -> QuerySelector:
    if strategy == "uniform":
        return UniformQueries(rng)
    if strategy == "contest":
        return Contest(rng, wanted)
    ensemble = TransportEnsemble(seed.pool.originals, seed.summary.episode_ids, seed.preset, rng)
    return make_selector(strategy, rng, seed.summary, ensemble)


def strategies(seed: Seed, done: Callable[..., bool], keep: Callable[[Unit], None]) -> None:
    """Each strategy at each budget; the answers of a smaller budget are the first of a larger, but
    for the contest, which asks otherwise when it may ask more."""
    for number, strategy in enumerate(("uniform", *LEARNING, "contest")):
        if done(study="strategies", strategy=strategy, budget=BUDGETS[0]):
            continue
        rankings: list[Ranking] = []
        for budget in reversed(BUDGETS):
            if not rankings or strategy == "contest":
                human, began_s = SimulatedHuman(seed.rng(2)), time.monotonic()
                selector = _selector(seed, strategy, budget, seed.rng(1, number))
                rankings = seed.ask(selector, lambda n: ("ann", "task", human), budget)  # noqa: B023
                asking_s = time.monotonic() - began_s
            some = rankings[:budget]
            ranked = {video for r in some for video in r.episode_ids}
            experts = expert_set(some, min(EXPERTS, len(ranked)))
            found = seed.judge(triplets_from(some), experts)["task"]
            keep({"study": "strategies", "strategy": strategy, "budget": budget,
                  "asking_s": asking_s, **found})  # fmt: skip


def noise(seed: Seed, done: Callable[..., bool], keep: Callable[[Unit], None]) -> None:
    """Wrong answers of one annotator, and of three who err unevenly."""
    crowds = {f"{rate:.0%}": {"ann": rate} for rate in RATES} | {"uneven": UNEVEN}
    for number, (title, rates) in enumerate(crowds.items()):
        people = {
            name: SimulatedHuman(
                seed.rng(3, number, i), HumanKnobs(mistakes=rate, mistake_kind="any")
            )
            for i, (name, rate) in enumerate(rates.items())
        }
        names = list(people)

        def who(n: int) -> tuple[str, str, SimulatedHuman]:
            name = names[n % len(names)]  # noqa: B023
            return name, "task", people[name]  # noqa: B023

        rankings = seed.ask(UniformQueries(seed.rng(4)), who, BUDGETS[-1])
        for kind in NOISES:
            if done(study="noise", wrong=title, noise=kind):
                continue
            config = PeopleConfig(noise=kind)
            (lesson,) = study_people(rankings, seed.summary, config, EXPERTS, seed.rng(5)).lessons[
                :1
            ]
            found = seed.judge(lesson.triplets, lesson.expert_ids, kind)["task"]
            estimate = lesson.mistakes.by_annotator if lesson.mistakes else {}
            keep({"study": "noise", "wrong": title, "noise": kind, "estimate": estimate,
                  "really_wrong": _wrong_pairs(rankings, seed.pool), **found})  # fmt: skip


def _wrong_pairs(rankings: Sequence[Ranking], pool: Videos) -> dict[str, float]:
    """Share of comparisons that each annotator answered wrong."""
    returns = pool.returns()
    found: dict[str, list[bool]] = {}
    for ranking in rankings:
        ranked = list(zip(ranking.ranks, ranking.episode_ids, strict=True))
        for i, (rank, video) in enumerate(ranked):
            for other, another in ranked[i + 1 :]:
                wrong = (rank < other) != (returns[video] > returns[another])
                found.setdefault(ranking.annotator, []).append(wrong)
    return {name: float(np.mean(wrong)) for name, wrong in found.items()}


def groups(seed: Seed, done: Callable[..., bool], keep: Callable[[Unit], None]) -> None:
    """Two people who want the task and two who want its opposite."""
    if done(study="groups", learnt="one a group"):
        return
    names, human = list(WISHES), SimulatedHuman(seed.rng(9))

    def who(n: int) -> tuple[str, str, SimulatedHuman]:
        name = names[n % len(names)]
        return name, WISHES[name], human

    rankings = seed.ask(UniformQueries(seed.rng(6)), who, BUDGETS[-1])
    wishes = ("task", "opposite")
    for learnt, count in (("one for all", 1), ("one a group", 0)):
        people = study_people(
            rankings, seed.summary, PeopleConfig(groups=count), EXPERTS, seed.rng(5)
        )
        by_wish: dict[str, dict[str, float]] = {}
        for lesson in people.lessons:
            found = seed.judge(lesson.triplets, lesson.expert_ids, wishes=wishes)
            for wish in wishes:
                if wish in _wishes_of(lesson):
                    by_wish[wish] = found[wish]
        keep({"study": "groups", "learnt": learnt, "text": people.text,
              "groups": [list(lesson.annotators) for lesson in people.lessons],
              **{f"{w}_{key}": v for w in wishes for key, v in by_wish[w].items()}})  # fmt: skip


def _wishes_of(lesson: GroupLesson) -> set[str]:
    return {WISHES[name] for name in lesson.annotators}


def main() -> None:
    """Do what is not done yet and keep it in ``results/sample_efficiency.json``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[9, 10, 11, 12, 13])
    parser.add_argument("--preset", default="tuned")
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="videos, features")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    path = options.results / "sample_efficiency.json"
    found = json.loads(path.read_text()) if path.is_file() else {"units": []}
    begun_at = commit()

    for number in options.seeds:
        seed: Seed | None = None

        def done(**what: Any) -> bool:
            what |= {"seed": number, "preset": options.preset}  # noqa: B023
            return any(what.items() <= _flat(unit).items() for unit in found["units"])

        def keep(unit: Unit) -> None:
            unit |= {"seed": number, "preset": options.preset, "commit": begun_at}  # noqa: B023
            same = {key: unit.get(key) for key in KEYS}
            found["units"] = [
                old for old in found["units"] if {key: old.get(key) for key in KEYS} != same
            ]
            found["units"].append(unit)
            found["machine"] = machine()
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_suffix(".partial")
            beside.write_text(json.dumps(found, indent=1, default=str) + "\n")
            beside.replace(path)
            print(json.dumps(unit), flush=True)

        for study in (strategies, noise, groups):
            seed = seed or Seed(number, get_preset(options.preset), options.work)
            study(seed, done, keep)


def _flat(unit: Unit) -> Unit:
    """Without what cannot be compared by a set."""
    return {key: value for key, value in unit.items() if not isinstance(value, dict | list)}


if __name__ == "__main__":
    main()
