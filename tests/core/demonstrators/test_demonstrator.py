"""People-like ways of pushing: what they bring about, told by the task itself."""

import numpy as np
import pytest

from rapl_core.demonstrators import (
    behaviour_names,
    collect,
    draw_behaviours,
    make_demonstrator,
)
from rapl_core.errors import UnknownNameError
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task


@pytest.fixture(scope="module", params=["franka_group", "kuka_group"])
def simulation(request):
    simulation = Simulation(get_task(request.param), render=False)
    yield simulation
    simulation.close()


def play(simulation, behaviour, episode):
    rng = np.random.default_rng([7, episode])
    demonstrator = make_demonstrator(simulation.task, behaviour, rng)
    snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, episode))
    states = [snapshot.state]
    while not snapshot.is_last:
        snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))
        states.append(snapshot.state)
    return np.stack(states), snapshot.success


@pytest.mark.parametrize(
    "behaviour", ["together_from_behind", "together_from_ahead", "together_side_by_side"]
)
def test_preferred_ways_mostly_succeed(simulation, behaviour):
    succeeded = [play(simulation, behaviour, episode)[1] for episode in range(20)]
    assert np.mean(succeeded) >= 0.6


def test_one_at_a_time_arrives_and_still_fails_for_want_of_grouping(simulation):
    plays = [play(simulation, "one_at_a_time", episode) for episode in range(40)]
    arrived = [bool((np.abs(states[-1, [10, 13]] - 0.28) <= 0.08).all()) for states, _ in plays]
    assert np.mean(arrived) >= 0.8
    assert np.mean([success for _, success in plays]) <= 0.05


def test_a_mime_moves_the_arm_and_no_cube(simulation):
    for episode in range(10):
        states, _ = play(simulation, "mime", episode)
        assert np.ptp(states[:, 7]) > 0.2
        assert np.abs(states[-1, 10:16] - states[0, 10:16]).max() < 0.02


def test_behaviours_are_shown_in_their_shares(simulation):
    shown = draw_behaviours(simulation.task, 200, np.random.default_rng(0))
    assert len(shown) == 200 and set(shown) == set(behaviour_names(simulation.task))
    assert shown.count("mime") in (20, 21)
    only = draw_behaviours(simulation.task, 5, np.random.default_rng(0), ("mime",))
    assert only == ["mime"] * 5


def test_an_unknown_behaviour_names_the_known_ones(simulation):
    with pytest.raises(UnknownNameError, match="together_from_behind"):
        make_demonstrator(simulation.task, "juggle", np.random.default_rng(0))


def test_collected_episodes_are_complete_and_reproducible():
    simulation = Simulation(get_task("franka_group"))
    first, again = (list(collect(simulation, 2, seed=3)) for _ in range(2))
    simulation.close()
    for one, two in zip(first, again, strict=True):
        assert one.steps == simulation.task.horizon
        assert np.array_equal(one.frames, two.frames) and np.array_equal(one.states, two.states)
    assert first[0].episode_id != first[1].episode_id
    assert first[0].stamps_ns[-1] < first[1].stamps_ns[0]
