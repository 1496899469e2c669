"""What the tabletop scenes share."""

import mujoco
import numpy as np
import pytest

from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task

FLIGHT_STEPS = 500
"""2 s: at 3 m/s a free box is far beyond the table."""


@pytest.mark.parametrize("name", ["franka_group", "kuka_group", "franka_clutter"])
@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_nothing_leaves_the_table(name, direction):
    task = get_task(name)
    model = Simulation(task, 1, render=False).model
    boxes = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    assert boxes
    for joint in boxes:
        data = mujoco.MjData(model)
        task.bind(model).reset(data, np.random.default_rng(0))
        at, velocity = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        # well above the other boxes and the arm, half a metre from the middle
        data.qpos[at : at + 3] = [0.5 * direction[0], 0.5 * direction[1], 0.1]
        data.qvel[velocity : velocity + 3] = [3.0 * direction[0], 3.0 * direction[1], 1.0]
        mujoco.mj_step(model, data, FLIGHT_STEPS)
        x, y, z = data.qpos[at : at + 3]
        assert abs(x) < task.config.table_half[0] and abs(y) < task.config.table_half[1]
        assert z > 0
