"""Robots are drawn with few triangles, whatever their meshes are made of."""

import pytest

from rapl_core.simulation.meshes import drawn_triangles
from rapl_core.simulation.simulation import VISUAL_GROUP, Simulation
from rapl_core.tasks import get_task


@pytest.mark.parametrize("name", ["franka_group", "kuka_group", "franka_clutter"])
def test_a_robot_is_drawn_with_about_as_many_triangles_as_its_task_says(name):
    task = get_task(name)
    low = drawn_triangles(Simulation(task, render=False).model, VISUAL_GROUP)
    assert 0.5 * task.visual_triangles < low < 2.5 * task.visual_triangles


def test_the_original_meshes_have_many_times_more():
    simulation = Simulation(get_task("kuka_group"), render=False, full_meshes=True)
    assert drawn_triangles(simulation.model, VISUAL_GROUP) > 100_000
