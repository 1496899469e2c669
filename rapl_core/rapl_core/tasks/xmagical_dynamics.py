"""How an X-MAGICAL world starts and what an action does to it."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.tasks.xmagical_bodies import FINGER_RANGE, get_body
from rapl_core.tasks.xmagical_scene import PlanarConfig

FINGER_SPEED = 1.0
"""rad/s at most."""


@dataclass(frozen=True)
class PlanarScene:
    """Where everything is."""

    robot: NDArray[np.float64]
    """(3,) x, y in m and heading in rad within [-pi, pi), 0 is up the picture."""
    blocks: NDArray[np.float64]
    """(N, 2) m."""
    opening: float | None = None
    """Of the gripper: 0 closed, 1 open; None without fingers."""


class PlanarDynamics:
    """A planar task on a compiled model.

    :param draw_start: generator -> robot (3,) and blocks (N, 2).
    :param observe: scene -> privileged state (S,).
    """

    def __init__(
        self,
        config: PlanarConfig,
        model: mujoco.MjModel,
        draw_start: Callable[[np.random.Generator], PlanarScene],
        observe: Callable[[PlanarScene], NDArray[np.float64]],
    ) -> None:
        self._config = config
        self._model = model
        self._draw_start = draw_start
        self._observe = observe
        self._has_fingers = get_body(config.body).has_fingers
        robot = [f"robot_{axis}" for axis in ("x", "y", "yaw")]
        fingers = ["left_finger", "right_finger"] if self._has_fingers else []
        names = [*robot, *fingers]
        self._joints = np.array([model.joint(j).qposadr[0] for j in names])
        self._joint_dofs = np.array([model.joint(j).dofadr[0] for j in names])
        self._robot, self._fingers = self._joints[:3], self._joints[3:]
        self._drive, self._turn = model.actuator("forward").id, model.actuator("turn").id
        self._finger_servos = np.array([model.actuator(j).id for j in fingers], dtype=np.intp)
        self._blocks = np.array(
            [
                [model.joint(f"block{i + 1}_{axis}").qposadr[0] for axis in ("x", "y", "yaw")]
                for i in range(len(config.block_colors))
            ]
        )  # (N, 3)

    def reset(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Place robot and blocks at a random start."""
        start = self._draw_start(rng)
        self.place(data, start.robot, start.blocks)

    def place(
        self,
        data: mujoco.MjData,
        robot: NDArray[np.float64],
        blocks: NDArray[np.float64],
    ) -> None:
        """Put robot and blocks somewhere, at rest; fingers open.

        :param robot: (3,) x, y in m and heading in rad.
        :param blocks: (N, 2) x, y in m, or (N, 3) with the angle in rad.
        """
        mujoco.mj_resetData(self._model, data)
        data.qpos[self._robot] = robot
        data.qpos[self._blocks[:, : blocks.shape[1]]] = blocks
        if self._has_fingers:
            data.qpos[self._fingers] = FINGER_RANGE, -FINGER_RANGE
            data.ctrl[self._finger_servos] = data.qpos[self._fingers]
        mujoco.mj_forward(self._model, data)

    def apply(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Set speed and turning, and move the fingers' set point, by an action (2 or 3,)."""
        config = self._config
        data.ctrl[self._drive] = np.clip(action[0], -config.speed_limit, config.speed_limit)
        share = np.clip(action[1] / config.full_turn, -1.0, 1.0)
        data.ctrl[self._turn] = config.turn_rate * share
        if self._has_fingers:
            target = np.clip(FINGER_RANGE - action[2], 0.0, FINGER_RANGE)
            reach = FINGER_SPEED * config.timestep_s * config.substeps
            angle = data.ctrl[self._finger_servos[0]]
            angle += np.clip(target - angle, -reach, reach)
            data.ctrl[self._finger_servos] = angle, -angle

    def scene(self, data: mujoco.MjData) -> PlanarScene:
        """Return where everything is."""
        robot = data.qpos[self._robot].copy()
        robot[2] = (robot[2] + np.pi) % (2 * np.pi) - np.pi
        opening = None
        if self._has_fingers:
            left, right = data.qpos[self._fingers]
            opening = float(np.clip((left - right) / (2 * FINGER_RANGE), 0.0, 1.0))
        return PlanarScene(robot, data.qpos[self._blocks[:, :2]].copy(), opening)

    def state(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the privileged state (S,)."""
        return self._observe(self.scene(data))

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of the joints in m and rad."""
        return data.qpos[self._joints].copy(), data.qvel[self._joint_dofs].copy()
