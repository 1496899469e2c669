"""Ways of handling prisms among cubes: what they bring about, told by the task itself."""

import numpy as np
import pytest

from rapl_core.demonstrators import make_demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task


@pytest.fixture(scope="module")
def simulation():
    return Simulation(get_task("franka_clutter"), render=False)


def play(simulation, behaviour, episode):
    rng = np.random.default_rng([7, episode])
    demonstrator = make_demonstrator(simulation.task, behaviour, rng)
    snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, episode))
    states = [snapshot.state]
    while not snapshot.is_last:
        snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))
        states.append(snapshot.state)
    return np.stack(states), snapshot.success


@pytest.mark.parametrize("behaviour", ["push_with_held", "line_up"])
def test_preferred_ways_mostly_succeed(simulation, behaviour):
    assert np.mean([play(simulation, behaviour, episode)[1] for episode in range(6)]) >= 0.6


def test_one_at_a_time_arrives_and_still_fails_for_want_of_grouping(simulation):
    plays = [play(simulation, "one_at_a_time", episode) for episode in range(10)]
    config = simulation.task.config
    along = np.array([states[-1, [10, 13]] for states, _ in plays])  # (10, 2)
    arrived = ((along >= config.goal_near) & (along <= config.goal_far)).all(axis=1)
    assert np.mean(arrived) >= 0.8
    assert not any(success for _, success in plays)


def test_the_wrong_shape_moves_cubes_and_no_prism(simulation):
    for episode in range(3):
        states, success = play(simulation, "cubes_together", episode)
        assert not success
        assert np.abs(states[-1, 10:16] - states[0, 10:16]).max() < 0.02
        assert np.abs(states[-1, 16:22] - states[0, 16:22]).max() > 0.1


def test_a_mime_moves_the_arm_and_nothing_else(simulation):
    for episode in range(4):
        states, _ = play(simulation, "mime", episode)
        assert np.ptp(states[:, 7]) > 0.3 and np.ptp(states[:, 9]) > 0.02
        assert np.abs(states[-1, 10:28] - states[0, 10:28]).max() < 0.02
