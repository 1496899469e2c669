"""Damped least-squares inverse kinematics for a gripper that points down."""

import mujoco
import numpy as np
from numpy.typing import NDArray

DAMPING = 1e-3
"""m^2, squared damping of the least-squares step (Buss 2004, eq. 11)."""
NULL_SPACE_GAIN = 0.02
"""Share of the way to the home posture a step, in the null space of the task."""


class ArmKinematics:
    """Inverse kinematics of one arm in a compiled model.

    :param joints: names of the arm's joints in the model.
    :param site: name of the site between the fingertips.
    :param home: posture in rad towards which redundancy is resolved.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: list[str], site: str, home: NDArray[np.float64]
    ) -> None:
        self._model = model
        self._scratch = mujoco.MjData(model)
        self._qpos = np.array([model.joint(j).qposadr[0] for j in joints])
        self._dof = np.array([model.joint(j).dofadr[0] for j in joints])
        self._site = model.site(site).id
        self._home = home
        self._jac_position = np.zeros((3, model.nv))
        self._jac_rotation = np.zeros((3, model.nv))
        # the fingers stand side by side across the direction of pushing, like a fork
        self._down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

    def step(
        self, angles: NDArray[np.float64], target: NDArray[np.float64], gain: float = 1.0
    ) -> NDArray[np.float64]:
        """Return angles (7,) in rad one damped step closer to ``target`` (3,) in m."""
        data = self._scratch
        data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        rotation = data.site_xmat[self._site].reshape(3, 3)
        mujoco.mj_jacSite(self._model, data, self._jac_position, self._jac_rotation, self._site)
        jacobian = np.vstack([self._jac_position[:, self._dof], self._jac_rotation[:, self._dof]])
        turn = self._down @ rotation.T
        error = np.empty(6)
        error[:3] = target - data.site_xpos[self._site]
        error[3:] = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        damped = jacobian @ jacobian.T + DAMPING * np.eye(6)  # (6, 6)
        pulled = self._home - angles
        # dq = J+ e + (I - J+ J) k (home - q) with the damped pseudo-inverse J+
        solved = np.linalg.solve(damped, error - NULL_SPACE_GAIN * (jacobian @ pulled))
        return np.asarray(
            angles + gain * (jacobian.T @ solved + NULL_SPACE_GAIN * pulled), dtype=np.float64
        )

    def solve(
        self, target: NDArray[np.float64], iterations: int = 100, gain: float = 0.2
    ) -> NDArray[np.float64]:
        """Return angles (7,) in rad that put the gripper at ``target`` (3,) in m."""
        angles = self._home.copy()
        for _ in range(iterations):
            angles = self.step(angles, target, gain)
        return angles
