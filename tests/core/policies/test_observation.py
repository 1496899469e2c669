"""The policy's observation: features and their change."""

import numpy as np
import pytest

from rapl_core.errors import ShapeError
from rapl_core.policies.observation import CHANGE_FACTOR, observation_size, observe
from rapl_core.policies.rollout import Rollout
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task


@pytest.fixture(scope="module")
def simulation():
    return Simulation(get_task("franka_group"))


def test_the_observation_is_the_features_and_how_they_changed(simulation):
    task = simulation.task
    before = simulation.reset(0, np.random.default_rng(0)).state
    state = simulation.step(0, np.ones(len(task.action_names))).state
    now, changed = np.split(observe(task, state, before), 2)
    np.testing.assert_array_equal(now, task.policy_features(state))
    difference = task.policy_features(state) - task.policy_features(before)
    np.testing.assert_allclose(changed, CHANGE_FACTOR * difference, rtol=1e-6)
    assert np.abs(changed).max() > 0.1
    assert len(now) + len(changed) == observation_size(task)


def test_nothing_has_changed_at_the_start_of_an_episode(simulation):
    state = simulation.reset(0, np.random.default_rng(0)).state
    now, changed = np.split(observe(simulation.task, state), 2)
    assert now.any() and not changed.any()


def test_a_rollout_observes_each_state_beside_the_one_before_it(simulation):
    task, seen = simulation.task, []

    def act(step, observations):
        seen.append(observations[0])
        return np.full((1, len(task.action_names)), 0.5)

    for number in (0, 1):
        seen.clear()
        (ended,) = Rollout(simulation, 3).run("evaluate", number, act, frames=False)
        states = ended.episode.states
        expected = [observe(task, s, b) for s, b in zip(states, [None, *states], strict=False)]
        np.testing.assert_array_equal([*seen, ended.last_observation], expected)


def test_a_state_of_another_size_is_refused_by_name():
    with pytest.raises(ShapeError, match="franka_group.*(3,)"):
        observe(get_task("franka_group"), np.zeros(3))
