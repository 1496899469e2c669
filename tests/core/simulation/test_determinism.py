"""Two runs with the same seed give the same states to the last bit."""

import numpy as np
import pytest

from rapl_core.demonstrators import collect
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names

DRAWN = ("franka_group", "kuka_group", "franka_clutter", "xmagical_group", "xmagical_avoid_gripper")
"""At least one of each family: that drawing changes nothing is the same for all of them."""


def run(name, draws):
    """Two scripted episodes of a simulation of their own: all kinds of contacts, and noise."""
    simulation = Simulation(get_task(name), render=draws)
    episodes = list(collect(simulation, 2, seed=6))
    simulation.close()
    return episodes


@pytest.mark.parametrize("name", task_names())
def test_two_runs_of_a_seed_are_the_same_to_the_last_bit(name):
    """Even where one of them draws pictures."""
    for one, two in zip(run(name, draws=False), run(name, draws=name in DRAWN), strict=True):
        assert one.behaviour == two.behaviour and one.success == two.success
        for part in ("states", "actions", "human_rewards", "stamps_ns"):
            assert np.array_equal(getattr(one, part), getattr(two, part)), part
