"""Objects are seen: by the simulator's own segmentation, in episodes of the preferred kind."""

import numpy as np
import pytest

from rapl_core.analysis.visibility import hidden_shares, object_bodies, seen_shares
from rapl_core.demonstrators import behaviours_of, make_demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task

EVERY = 6
"""Steps between two looks."""


@pytest.mark.parametrize("name", ["franka_group", "kuka_group", "franka_clutter"])
def test_no_object_is_hidden_for_more_than_a_third_of_a_preferred_episode(name):
    task = get_task(name)
    simulation = Simulation(task)
    preferred = [b.name for b in behaviours_of(task).values() if b.preferred]
    for episode, behaviour in enumerate(preferred):
        demonstrator = make_demonstrator(task, behaviour, np.random.default_rng(episode))
        snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, episode))
        looks = []
        while not snapshot.is_last:
            if snapshot.step % EVERY == 0:
                looks.append(seen_shares(simulation))
            snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))
        hidden = hidden_shares(looks)
        assert max(hidden.values()) <= 1 / 3, (behaviour, hidden)
    simulation.close()


def test_what_stands_behind_another_shows_less_and_alone_it_shows_all():
    simulation = Simulation(get_task("franka_group"))
    gripper = np.array([-0.2, 0.2])
    bodies = object_bodies(simulation.model)
    assert set(bodies) == {"cube1", "cube2"}
    places = {"apart": [(0.0, -0.1), (0.1, 0.1)], "in line": [(0.0, -0.1), (0.07, -0.1)]}
    shares = {}
    for word, cubes in places.items():
        simulation.dynamics.place(simulation.data[0], gripper, [np.array(c) for c in cubes])
        shares[word] = seen_shares(simulation)
    simulation.close()
    assert shares["apart"] == {"cube1": 1.0, "cube2": 1.0}
    assert shares["in line"]["cube2"] == 1.0 and shares["in line"]["cube1"] < 0.8


def test_hidden_is_counted_over_instants():
    looks = [{"a": 1.0, "b": 0.1}, {"a": 0.2, "b": 0.0}, {"a": 0.9, "b": 0.9}, {"a": 0.3, "b": 0.2}]
    assert hidden_shares(looks) == {"a": 0.25, "b": 0.75}
