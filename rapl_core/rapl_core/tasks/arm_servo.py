"""An arm with a gripper in a compiled scene: where it is, and what its servos are told."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.simulation.arm import ArmKinematics
from rapl_core.tasks.robots import get_robot
from rapl_core.tasks.scene import SceneConfig

SITE = "robot_gripper_grip_site"


class ArmServo:
    """Moves the gripper of a scene at one height; everything that evolves is in ``MjData``."""

    def __init__(self, config: SceneConfig, model: mujoco.MjModel) -> None:
        robot = get_robot(config.robot)
        self._config = config
        self._gripper = robot.gripper
        arm = [f"robot_{joint}" for joint in robot.arm_joints]
        names = [*arm, *(f"robot_gripper_{joint}" for joint in robot.gripper.joints)]
        self._kinematics = ArmKinematics(model, arm, SITE, np.array(robot.home))
        self._size = len(arm)
        self._joints = np.array([model.joint(j).qposadr[0] for j in names])
        self._dofs = np.array([model.joint(j).dofadr[0] for j in names])
        self._servos = np.array([model.actuator(j).id for j in names])
        self._site = model.site(SITE).id

    def place(self, data: mujoco.MjData, gripper: NDArray[np.float64], opening: float) -> None:
        """Put the gripper at (2,) m with its fingers ``opening`` m from the middle, at rest."""
        target = np.array([*gripper, self._config.gripper_height])
        posture = [*self._kinematics.solve(target), *self._gripper.positions(opening)]
        data.qpos[self._joints] = posture
        data.ctrl[self._servos] = posture
        data.mocap_pos[0] = target

    def move(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Move the gripper's set point by an action (2,) and the arm's servos after it."""
        config = self._config
        low_x, high_x, low_y, high_y = config.gripper_area
        target = data.mocap_pos[0]
        target[0] = np.clip(target[0] + config.speed * action[0], low_x, high_x)
        target[1] = np.clip(target[1] + config.speed * action[1], low_y, high_y)
        servos = self._servos[: self._size]
        angles = data.ctrl[servos]
        for _ in range(2):
            angles = self._kinematics.step(angles, target)
        data.ctrl[servos] = angles

    def open_fingers(self, data: mujoco.MjData, opening: float) -> None:
        """Tell the fingers to stand ``opening`` m from the middle."""
        data.ctrl[self._servos[self._size :]] = self._gripper.positions(opening)

    def told_opening(self, data: mujoco.MjData) -> float:
        """Return the opening in m a finger that the fingers were last told."""
        return self._gripper.opening(data.ctrl[self._servos[self._size :]])

    def opening(self, data: mujoco.MjData) -> float:
        """Return how far in m the fingers stand from the middle, on average."""
        return self._gripper.opening(data.qpos[self._joints[self._size :]])

    def angles(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the arm's angles (7,) in rad."""
        return np.asarray(data.qpos[self._joints[: self._size]])

    def position(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the point between the fingertips (3,) in m."""
        return np.asarray(data.site_xpos[self._site])

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of arm and finger joints in rad and m."""
        return data.qpos[self._joints].copy(), data.qvel[self._dofs].copy()
