"""Objects are seen: by the simulator's own segmentation, in episodes of the preferred kind."""

import json
from pathlib import Path

import numpy as np
import pytest

from rapl_core.analysis.visibility import (
    hidden_in_episode,
    hidden_shares,
    object_bodies,
    seen_shares,
)
from rapl_core.demonstrators import behaviours_of
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names

RESULTS = Path(__file__).parents[3] / "experiments" / "results" / "visibility.json"
SHOWN = [
    "franka_group",
    "kuka_group",
    "franka_clutter",
    "xmagical_avoid_gripper",
    "xmagical_group_longstick",
    "xmagical_sweep_gripper",
]
"""Every arm, and of the planar tasks those with the bodies that reach over most. The script plays
all tasks."""
KINDS = ("block", "cube", "prism")


@pytest.mark.parametrize("name", SHOWN)
def test_no_object_is_hidden_for_more_than_a_third_of_a_preferred_episode(name):
    task = get_task(name)
    simulation = Simulation(task)
    preferred = [b.name for b in behaviours_of(task).values() if b.preferred]
    for episode, behaviour in enumerate(preferred):
        hidden = hidden_in_episode(simulation, behaviour, episode, every=10)
        assert max(hidden.values()) <= 1 / 3, (behaviour, hidden)
    simulation.close()


def test_the_results_of_all_tasks_say_the_same():
    rows = json.loads(RESULTS.read_text())
    assert set(rows) == set(task_names())
    for name, row in rows.items():
        assert row["worst"]["share"] <= 1 / 3 and row["episodes_above"] == 0, (name, row["worst"])


@pytest.mark.parametrize("name", task_names())
def test_the_objects_of_a_task_are_all_but_its_robot(name):
    simulation = Simulation(get_task(name), render=False)
    named = {n.split("_")[0] for n in simulation.task.state_names if n.startswith(KINDS)}
    assert set(object_bodies(simulation.model)) == named


def test_what_stands_behind_another_shows_less_and_alone_it_shows_all():
    simulation = Simulation(get_task("franka_group"))
    gripper = np.array([-0.2, 0.2])
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
