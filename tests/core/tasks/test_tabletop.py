"""The grouping task: its numbers follow from the state alone."""

import numpy as np
import pytest

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.tasks import get_task, task_names


@pytest.fixture(scope="module")
def task():
    return get_task("franka_group")


def state_with(task, one, two):
    state = np.zeros(18)
    state[10:13], state[13:16] = [*one, 0.03], [*two, 0.03]
    state[16], state[17] = task.goal_distance(state[10:13]), task.goal_distance(state[13:16])
    return state


def test_state_has_the_18_numbers_of_the_paper(task):
    assert len(task.state_names) == len(task.state_units) == 18


def test_an_unknown_task_names_the_known_ones():
    with pytest.raises(UnknownNameError, match="franka_group"):
        get_task("franka_grope")
    assert "franka_group" in task_names()


def test_human_reward_is_the_papers(task):
    state = state_with(task, (0.0, 0.0), (0.1, 0.1))
    assert task.human_reward(state, state) == pytest.approx(-0.23 - np.hypot(0.1, 0.1))


def test_the_goal_is_bounded_on_both_sides(task):
    assert task.goal_distance(np.array([0.28, 0.0, 0.03])) == 0.0
    assert task.goal_distance(np.array([0.10, 0.0, 0.03])) == pytest.approx(0.13)
    assert task.goal_distance(np.array([0.40, 0.0, 0.03])) == pytest.approx(0.07)


def ride(task, ways):
    return np.stack([state_with(task, one, two) for one, two in ways])


def test_success_wants_both_cubes_together_from_the_moment_one_enters(task):
    apart, near_goal = ((0.0, 0.0), (0.1, 0.1)), ((0.15, 0.0), (0.18, 0.06))
    inside = ((0.25, 0.0), (0.27, 0.06))
    one_in_apart = ((0.25, 0.0), (0.0, 0.1))
    assert task.success(ride(task, [apart, near_goal, inside]))
    assert not task.success(ride(task, [apart, one_in_apart, inside])), "apart while one was in"
    assert not task.success(ride(task, [apart, inside, near_goal])), "left the goal again"
    assert not task.success(ride(task, [apart, near_goal])), "never arrived"
    beyond = ((0.40, 0.0), (0.38, 0.06))
    assert not task.success(ride(task, [apart, inside, beyond])), "pushed through the goal"


def test_policy_features_are_finite_and_of_one_size(task):
    features = task.policy_features(state_with(task, (0.0, 0.0), (0.1, 0.1)))
    assert features.dtype == np.float32 and np.isfinite(features).all()


def test_a_state_of_another_shape_is_refused_by_name(task):
    with pytest.raises(ShapeError, match=r"franka_group.*\(18,\)"):
        task.human_reward(np.zeros(17), np.zeros(18))
