"""The clutter task: its numbers follow from the logged states alone, and a grasp is needed."""

import numpy as np
import pytest

from rapl_core.errors import ShapeError
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task

CUBES = np.array([[0.02, -0.19], [0.14, -0.175], [0.30, 0.215], [0.31, -0.17]])


@pytest.fixture(scope="module")
def task():
    return get_task("franka_clutter")


def state_with(task, one, two, cubes=CUBES):
    flat = np.array([one, two, *cubes])
    objects = np.column_stack([flat, np.full(6, 0.025)])
    return np.concatenate([np.zeros(10), objects.ravel(), task.goal_distances(objects)])


def test_state_has_the_34_numbers_of_the_paper(task):
    assert len(task.state_names) == len(task.state_units) == 34


def test_human_reward_is_the_papers_with_a_tenth_of_how_far_each_cube_was_moved(task):
    start = state_with(task, (0.0, 0.0), (0.1, 0.1))
    group = -0.25 - np.hypot(0.1, 0.1)
    assert task.human_reward(start, start) == pytest.approx(group)
    moved = CUBES + [[0.3, 0.4], [0.0, 0.0], [0.0, -0.1], [0.0, 0.0]]
    later = state_with(task, (0.0, 0.0), (0.1, 0.1), moved)
    assert task.human_reward(later, start) == pytest.approx(group - 0.1 * 0.5 - 0.1 * 0.1)


def test_an_object_is_in_the_goal_when_all_of_its_length_is(task):
    objects = np.zeros((6, 3))
    objects[:, 0] = [0.25, 0.40, 0.225, 0.10, 0.395, 0.45]
    assert task.goal_distances(objects) == pytest.approx([0.0, 0.03, 0.0, 0.125, 0.0, 0.055])


def ride(task, ways):
    return np.stack([state_with(task, *way) for way in ways])


def test_success_wants_both_prisms_together_and_the_cubes_left(task):
    apart, near_goal = ((0.0, 0.0), (0.1, 0.12)), ((0.08, 0.1), (0.18, 0.1))
    inside = ((0.25, 0.1), (0.35, 0.1))
    one_in_apart = ((0.0, 0.0), (0.3, 0.1))
    assert task.success(ride(task, [apart, near_goal, inside]))
    assert not task.success(ride(task, [apart, one_in_apart, inside])), "apart while one was in"
    assert not task.success(ride(task, [apart, near_goal])), "never arrived"
    assert not task.success(ride(task, [apart, inside, near_goal])), "left the goal again"
    shoved = (*inside, CUBES + [[0.0, 0.0], [0.07, 0.0], [0.0, 0.0], [0.0, 0.0]])
    assert not task.success(ride(task, [apart, near_goal, shoved])), "moved a cube"


def test_a_state_of_another_shape_is_refused_by_name(task):
    with pytest.raises(ShapeError, match=r"franka_clutter.*\(34,\)"):
        task.human_reward(np.zeros(18), np.zeros(34))


def test_policy_features_are_finite_and_of_one_size(task):
    features = task.policy_features(state_with(task, (0.0, 0.0), (0.1, 0.1)))
    assert features.dtype == np.float32 and features.shape == (45,) and np.isfinite(features).all()


@pytest.fixture(scope="module")
def simulation(task):
    return Simulation(task, render=False)


def drive(simulation, grip):
    """Slide the fork over the near prism, close or keep open, go 10 cm on; return what it did."""
    simulation.reset(0, episode_rng(0, "test", 0, 0))
    data = simulation.data[0]
    places = [(-0.05, 0.0), (0.1, 0.2), *CUBES]
    simulation.dynamics.place(data, np.array([-0.15, 0.0]), np.array(places), np.zeros(2))
    for _ in range(3):
        simulation.step(0, np.array([1.0, 0.0, -1.0]))
    for _ in range(6):
        simulation.step(0, np.array([0.0, 0.0, grip]))
    held = simulation.dynamics.state(data)
    for _ in range(5):
        simulation.step(0, np.array([0.0, 1.0, grip]))
    for _ in range(3):
        state = simulation.step(0, np.array([0.0, 0.0, grip])).state
    return held, state


def test_closed_fingers_hold_a_prism_and_carry_it_along(simulation):
    held, state = drive(simulation, 1.0)
    assert held[9] == pytest.approx(0.025, abs=0.003)
    assert state[10:12] - held[10:12] == pytest.approx(state[7:9] - held[7:9], abs=0.01)
    assert state[8] > 0.1


def test_the_open_fork_slides_past_a_prism_that_it_does_not_hold(simulation):
    simulation.reset(0, episode_rng(0, "test", 0, 0))
    data = simulation.data[0]
    places = [(-0.05, 0.0), (0.1, 0.2), *CUBES]
    simulation.dynamics.place(data, np.array([-0.15, 0.0]), np.array(places), np.zeros(2))
    for _ in range(10):
        state = simulation.step(0, np.array([1.0, 0.0, -1.0])).state
    assert state[7] > 0.1 and abs(state[10] + 0.05) < 0.01
