"""Worlds step the same way every time, and refuse what they cannot do."""

import numpy as np
import pytest

from rapl_core.errors import RaplError, ShapeError, UnknownNameError
from rapl_core.simulation.simulation import STREAMS, Simulation, episode_rng
from rapl_core.tasks import get_task


@pytest.fixture(scope="module", params=["franka_group", "kuka_group"])
def simulation(request):
    simulation = Simulation(get_task(request.param), worlds=2, render=False)
    yield simulation
    simulation.close()


def roll(simulation, world, rng_actions, episode, steps=60):
    states = [simulation.reset(world, episode_rng(0, "train", 0, episode)).state]
    for _ in range(steps):
        states.append(simulation.step(world, rng_actions.uniform(-1, 1, 2)).state)
    return np.stack(states)


def test_an_episode_is_the_same_to_the_last_bit_in_any_world_after_anything(simulation):
    first = roll(simulation, 0, np.random.default_rng(1), 5)
    roll(simulation, 1, np.random.default_rng(2), 6)
    again = roll(simulation, 1, np.random.default_rng(1), 5)
    assert np.array_equal(first, again)


def test_two_worlds_do_not_touch_each_other(simulation):
    alone = roll(simulation, 0, np.random.default_rng(3), 1)
    simulation.reset(0, episode_rng(0, "train", 0, 1))
    simulation.reset(1, episode_rng(0, "train", 0, 2))
    actions, others = np.random.default_rng(3), np.random.default_rng(4)
    for step in range(60):
        state = simulation.step(0, actions.uniform(-1, 1, 2)).state
        simulation.step(1, others.uniform(-1, 1, 2))
        assert np.array_equal(state, alone[step + 1])


def test_an_episode_ends_at_the_horizon_and_not_later(simulation):
    simulation.reset(0, episode_rng(0, "train", 0, 0))
    for step in range(1, simulation.task.horizon + 1):
        snapshot = simulation.step(0, np.zeros(2))
        assert snapshot.is_last == (step == simulation.task.horizon)
    with pytest.raises(RaplError, match="reset it"):
        simulation.step(0, np.zeros(2))


@pytest.mark.parametrize("action", [np.zeros(3), np.array([np.nan, 0.0])])
def test_a_bad_action_is_refused(simulation, action):
    simulation.reset(0, episode_rng(0, "train", 0, 0))
    with pytest.raises(ShapeError, match=r"expected \(2,\) finite"):
        simulation.step(0, action)


def test_no_start_is_shared_between_seed_streams():
    simulation = Simulation(get_task("franka_group"), worlds=2, render=False)
    starts = {}
    for stream in STREAMS:
        for world in range(2):
            for episode in range(100):
                rng = episode_rng(0, stream, world, episode)
                state = simulation.reset(0, rng).state
                key = tuple(state[10:16])
                assert key not in starts, f"{stream} starts as {starts[key]}"
                starts[key] = stream


def test_an_unknown_stream_names_the_known_ones():
    with pytest.raises(UnknownNameError, match="evaluate"):
        episode_rng(0, "evaluation", 0, 0)


def test_rendering_without_a_renderer_says_so(simulation):
    with pytest.raises(RaplError, match="render=False"):
        simulation.render(0)


@pytest.mark.parametrize("name", ["franka_group", "kuka_group"])
def test_each_cube_is_12_pixels_wide_over_most_of_the_table(name):
    simulation = Simulation(get_task(name))
    wide = []
    for x in np.linspace(-0.1, 0.33, 8):
        for y in (-0.15, 0.0, 0.15):
            simulation.dynamics.place(
                simulation.data[0],
                np.array([-0.22, -0.2]),
                [np.array([x, y]), np.array([0.6, 0.6])],
            )
            geom = simulation.model.body("cube1").geomadr[0]
            seen = simulation.renderer.segment(simulation.data[0]) == geom
            wide.append(np.ptp(np.nonzero(seen.any(axis=0))[0]) + 1 if seen.any() else 0)
    simulation.close()
    assert np.mean(np.array(wide) >= 12) >= 0.8, wide


def test_pictures_do_not_depend_on_what_was_drawn_before():
    simulation = Simulation(get_task("franka_group"), worlds=2)
    simulation.reset(0, episode_rng(0, "train", 0, 0))
    first = simulation.render(0)
    simulation.reset(1, episode_rng(0, "train", 0, 1))
    assert not np.array_equal(first, simulation.render(1))
    assert np.array_equal(first, simulation.render(0))
    simulation.close()
