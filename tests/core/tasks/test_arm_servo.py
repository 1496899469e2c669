"""Both arms reach all of their working space, within their joints' limits."""

import itertools

import mujoco
import numpy as np
import pytest

from rapl_core.tasks import get_task
from rapl_core.tasks.arm_servo import ArmServo
from rapl_core.tasks.robots import ROBOTS, get_robot


@pytest.fixture(scope="module", params=["franka_group", "kuka_group"])
def arm(request):
    task = get_task(request.param)
    model = task.build_spec().compile()
    return task.config, model, mujoco.MjData(model), ArmServo(task.config, model)


def corners(config):
    low_x, high_x, low_y, high_y = config.gripper_area
    if config.robot == "panda":  # its elbow is at its limit beyond, where nothing has to be pushed
        high_x = 0.27
    return itertools.product((low_x, 0.0, high_x), (low_y, 0.0, high_y))


def test_the_gripper_gets_to_every_corner_and_its_posture_is_within_the_limits(arm):
    config, model, data, servo = arm
    joints = [f"robot_{name}" for name in get_robot(config.robot).arm_joints]
    limits = np.array([model.joint(name).range for name in joints])
    for corner in corners(config):
        servo.place(data, np.array(corner), config.finger_opening)
        for _ in range(10):
            servo.move(data, np.zeros(2))
        told = np.array([data.actuator(name).ctrl[0] for name in joints])
        assert (told > limits[:, 0]).all() and (told < limits[:, 1]).all(), (corner, told)
        for name, angle in zip(joints, told, strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        reached = servo.position(data)
        assert np.abs(reached - [*corner, config.gripper_height]).max() < 0.01, corner


def test_a_pushed_set_point_stays_in_the_area(arm):
    config, _, data, servo = arm
    servo.place(data, np.array([0.0, 0.0]), config.finger_opening)
    for _ in range(40):
        servo.move(data, np.array([1.0, -1.0]))
    assert data.mocap_pos[0][:2] == pytest.approx([config.gripper_area[1], config.gripper_area[2]])


def test_fingers_go_where_they_are_told(arm):
    _, model, data, servo = arm
    mujoco.mj_resetData(model, data)
    servo.place(data, np.array([0.0, 0.2]), 0.02)
    assert servo.opening(data) == pytest.approx(0.02)
    servo.open_fingers(data, 0.035)
    mujoco.mj_step(model, data, 400)
    assert servo.opening(data) == pytest.approx(0.035, abs=0.003)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_a_gripper_opens_by_what_its_joints_say(robot):
    for opening in (0.0, 0.013, 0.04):
        assert robot.gripper.opening(robot.gripper.positions(opening)) == pytest.approx(opening)
