"""Several people: mistakes are estimated, groups found, and both are said in plain words."""

import math

import numpy as np
import pytest
from videos import asked, made_videos

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.preferences import HumanKnobs, SimulatedHuman, expert_set
from rapl_core.preferences.groups import find_groups
from rapl_core.preferences.mistakes import estimate_mistakes
from rapl_core.preferences.people import PeopleConfig, study_people
from rapl_core.preferences.utility import comparisons, fit_utility
from rapl_core.preferences.video_features import summarise
from rapl_core.preferences.wishes import Person, wish_rewards
from rapl_core.types import DoubtedTriplet


def test_the_utility_is_the_optimum_of_its_objective() -> None:
    rng = np.random.default_rng(0)
    features, returns = made_videos(30, rng)
    x = summarise(features, components=5)
    pairs = comparisons(x, asked(returns, 20, rng))
    utility = fit_utility(pairs, 5)

    def objective(w: np.ndarray) -> float:
        return float(-np.logaddexp(0, -pairs.differences @ w).sum() - 0.5 * w @ w)

    best = objective(utility.weights)
    for direction in np.eye(5):
        for step in (1e-3, -1e-3):
            assert objective(utility.weights + step * direction) < best
        curvature = (
            objective(utility.weights + 1e-3 * direction)
            + objective(utility.weights - 1e-3 * direction)
            - 2 * best
        ) / 1e-6
        precision = np.linalg.inv(utility.covariance)
        assert -curvature == pytest.approx(direction @ precision @ direction, rel=1e-3)


def test_an_annotator_who_errs_gets_a_higher_rate_and_weighs_less() -> None:
    rng = np.random.default_rng(1)
    features, returns = made_videos(80, rng)
    careless = SimulatedHuman(rng, HumanKnobs(mistakes=0.6, mistake_kind="any"))
    rankings = asked(returns, 60, rng, "good") + asked(returns, 60, rng, "bad", careless)
    # 60 % of the rankings are one of the five other orders, which turn round 9 of 15 pairs.
    estimate = estimate_mistakes(summarise(features), rankings, rng)
    assert estimate.of("good") < 0.1 and 0.2 < estimate.of("bad") < 0.5
    assert estimate.accuracy > 0.7
    people = study_people(rankings, summarise(features), PeopleConfig(noise="estimated"), 10, rng)
    doubts = {t.mistakes for t in people.lessons[0].triplets if isinstance(t, DoubtedTriplet)}
    assert doubts == set(estimate_rates(people))
    assert "who errs more weighs less" in people.text and "bad" in people.text


def estimate_rates(people: object) -> list[float]:
    mistakes = people.lessons[0].mistakes  # type: ignore[attr-defined]
    return list(mistakes.by_annotator.values())


def test_too_few_answers_estimate_nothing() -> None:
    rng = np.random.default_rng(2)
    features, returns = made_videos(20, rng)
    estimate = estimate_mistakes(summarise(features), asked(returns, 5, rng), rng)
    assert math.isnan(estimate.accuracy) and estimate.rate == 0.05


def test_trust_decides_who_chooses_the_experts() -> None:
    rng = np.random.default_rng(3)
    _, returns = made_videos(12, rng)
    liar = {name: -value for name, value in returns.items()}
    rankings = asked(returns, 40, rng, "ada") + asked(liar, 40, rng, "eve")
    best = sorted(returns, key=lambda name: -returns[name])[:3]
    assert set(expert_set(rankings, 3, {"ada": 1.0, "eve": 0.01})) == set(best)
    assert set(expert_set(rankings, 3, {"ada": 0.01, "eve": 1.0})).isdisjoint(best)


def test_opposite_wishes_are_found_and_one_wish_is_not_split() -> None:
    rng = np.random.default_rng(4)
    features, returns = made_videos(60, rng)
    x = summarise(features)
    opposite = {name: -value for name, value in returns.items()}
    rankings = []
    for number, name in enumerate("abcdef"):
        rankings += asked(opposite if number % 2 else returns, 15, rng, name)
    groups = find_groups(x, rankings, rng)
    assert {frozenset(names) for names in groups.members} == {frozenset("ace"), frozenset("bdf")}
    assert groups.cross_agreement < 0.3
    people = study_people(rankings, x, PeopleConfig(groups=0), 5, rng)
    assert [len(lesson.rankings) for lesson in people.lessons] == [45, 45]
    assert "People disagree: 2 groups" in people.text
    together = study_people(rankings, x, PeopleConfig(), 5, rng)
    assert len(together.lessons) == 1 and "can please neither" in together.text

    alike = [r for name in "abcd" for r in asked(returns, 15, rng, name)]
    assert find_groups(x, alike, rng).count == 1
    with pytest.raises(RankingError, match="5 groups of 4 annotators"):
        find_groups(x, alike, rng, count=5)


def test_people_who_answer_in_turn_are_told_apart() -> None:
    rng = np.random.default_rng(6)
    features, returns = made_videos(60, rng)
    opposite = {name: -value for name, value in returns.items()}
    wishes = {"ann": returns, "ben": returns, "cyd": opposite, "dot": opposite}
    by_person = [asked(wish, 15, rng, name) for name, wish in wishes.items()]
    rankings = [ranking for four in zip(*by_person, strict=True) for ranking in four]
    groups = find_groups(summarise(features), rankings, rng)
    assert set(groups.members) == {("ann", "ben"), ("cyd", "dot")}


def test_one_person_needs_no_features_unless_something_is_to_be_estimated() -> None:
    rng = np.random.default_rng(5)
    _, returns = made_videos(10, rng)
    rankings = asked(returns, 8, rng)
    people = study_people(rankings, None, PeopleConfig(), 3, rng)
    assert people.text == "One annotator, ada." and len(people.lessons[0].triplets) == 8
    smooth = study_people(rankings, None, PeopleConfig(noise="smoothing"), 3, rng)
    assert all(t.mistakes == 0.1 for t in smooth.lessons[0].triplets)  # type: ignore[attr-defined]
    with pytest.raises(RankingError, match="without features"):
        study_people(rankings, None, PeopleConfig(noise="estimated"), 3, rng)
    with pytest.raises(RankingError, match="nobody has ranked"):
        study_people([], None, PeopleConfig(), 3, rng)


def test_wishes_are_felt_as_they_say() -> None:
    names = ["cube1_x", "cube1_y", "cube2_x", "cube2_y", "cube1_to_goal", "cube2_to_goal"]
    states = np.array([[0.0, 0.0, 0.3, 0.4, 0.2, 0.1], [0.0, 0.0, 0.0, 0.1, 0.0, 0.05]])
    human = np.array([-0.7, -0.15])
    assert wish_rewards("task", human, states, names).tolist() == [-0.7, -0.15]
    assert wish_rewards("opposite", human, states, names).tolist() == [0.7, 0.15]
    assert wish_rewards("progress", human, states, names).tolist() == [-0.2, -0.05]
    assert wish_rewards("apart", human, states, names) == pytest.approx([0.3, 0.05])
    with pytest.raises(UnknownNameError, match="wish 'fame'; known: apart, opposite"):
        Person("ada", "fame")
    with pytest.raises(RankingError, match="'ada' is no person, expected name:wish"):
        Person.parse("ada")
    assert Person.parse("ada:apart") == Person("ada", "apart")
    with pytest.raises(RankingError, match="no object's distance"):
        wish_rewards("apart", human, states[:, :2], names[:2])


def test_a_myopic_human_judges_by_the_end() -> None:
    rewards = np.array([-9.0, 0.0, 0.0, -1.0])
    assert SimulatedHuman(np.random.default_rng(0)).utility(rewards) == -10.0
    myopic = SimulatedHuman(np.random.default_rng(0), HumanKnobs(myopia=0.5))
    assert myopic.utility(rewards) == pytest.approx(-1.0 - 9.0 / 8)


def test_nothing_to_like_is_skipped_and_any_mistake_is_another_order() -> None:
    rng = np.random.default_rng(0)
    picky = SimulatedHuman(rng, HumanKnobs(skip_below=0.0))
    assert picky.answer([-1.0, -2.0]).verdict == "skipped"
    assert picky.answer([1.0, -2.0]).verdict == "ranked"
    wrong = SimulatedHuman(rng, HumanKnobs(mistakes=1.0, mistake_kind="any"))
    orders = {wrong.rank([3.0, 2.0, 1.0]) for _ in range(200)}
    assert len(orders) == 5 and (1, 2, 3) not in orders
