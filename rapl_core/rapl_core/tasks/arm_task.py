"""What the tasks of an arm at a table share: sizes and names that follow from their scene."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.tasks.robots import get_robot
from rapl_core.tasks.scene import SceneConfig


@dataclass(frozen=True)
class ArmTask:
    """An arm at a table: the part of a task that any scene has."""

    name: str
    title: str
    config: SceneConfig
    state_names: tuple[str, ...] = ()
    camera: str = "front"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's and the fingers' joints, as in the robot's own model."""
        robot = get_robot(self.config.robot)
        return robot.arm_joints + robot.gripper.joints

    @property
    def horizon(self) -> int:
        """T, transitions an episode."""
        return self.config.horizon

    @property
    def period_s(self) -> float:
        """Control period."""
        return self.config.timestep_s * self.config.substeps

    @property
    def substeps(self) -> int:
        """Physics steps a control period."""
        return self.config.substeps

    @property
    def image_size(self) -> int:
        """Height and width of the camera picture in pixels."""
        return self.config.image_size

    @property
    def visual_triangles(self) -> int:
        """About how many triangles the robot is drawn with."""
        return self.config.visual_triangles

    def checked(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the state (S,).

        :raises ShapeError: if it has another shape.
        """
        state = np.asarray(state, dtype=np.float64)
        if state.shape != (len(self.state_names),):
            raise ShapeError(
                f"state of {self.name} has shape {state.shape}, expected ({len(self.state_names)},)"
            )
        return state
