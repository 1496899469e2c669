"""The factor on r* of each task is the one that was fitted to its present videos."""

import json
from pathlib import Path

import pytest

from rapl_core.demonstrators import collect
from rapl_core.policies import fit_scale
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names

FITTED = json.loads((Path(__file__).parents[3] / "experiments/oracle/scales.json").read_text())


@pytest.mark.parametrize("name", task_names())
def test_the_scale_of_a_task_is_the_fitted_one(name):
    assert get_task(name).human_reward_scale == FITTED[name]["scale"]


@pytest.mark.parametrize("name", ["kuka_group", "xmagical_avoid_gripper"])
def test_the_fitted_one_is_that_of_the_videos_as_they_are(name):
    """Whoever changes a task's behaviours or their shares fits again."""
    row = FITTED[name]
    simulation = Simulation(get_task(name), render=False)
    videos = list(collect(simulation, row["scale_videos"], seed=row["seed"]))
    simulation.close()
    scale = fit_scale(v.human_rewards[1:] for v in videos if v.human_rewards is not None)
    assert scale == pytest.approx(row["scale"], rel=0.02)
