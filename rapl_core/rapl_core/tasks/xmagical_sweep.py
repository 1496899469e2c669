"""SweepToTop, the public benchmark's own task: three pieces of debris to the pink strip."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rapl_core.tasks.xmagical import PlanarTask
from rapl_core.tasks.xmagical_dynamics import PlanarScene
from rapl_core.tasks.xmagical_scene import PlanarConfig

SWEEP = PlanarConfig(
    blocks=((-0.5, 0.0), (0.0, 0.0), (0.5, 0.0)), block_colors=("red",) * 3, full_turn=1 / 16,
)  # fmt: skip
DIAGONAL = float(np.sqrt(8))
"""By which the public package divides distances."""
ARRIVED = 0.88
"""m; above it the public package counts a distance to the goal as nothing."""


@dataclass(frozen=True)
class SweepTask(PlanarTask):
    """Sweep three pieces of debris to the strip (Zakka et al. 2021).

    State and rewards are the public package's: robot (2), debris (6), cosine and sine of the
    heading, distances from robot to debris (3) and from debris to the top (3), each divided by
    the arena's diagonal, and with a gripper how far it is open.
    """

    config: PlanarConfig = SWEEP
    layout: Literal["demo", "random"] = "demo"
    """``demo``: the one start of the package; ``random``: its variant TestLayout."""
    reward: Literal["dense", "sparse"] = "dense"

    @property
    def state_names(self) -> tuple[str, ...]:
        """(16,) or, with a gripper, (17,) names of the privileged state."""
        debris = range(1, self.blocks + 1)
        return (
            "robot_x", "robot_y", *(f"block{i}_{axis}" for i in debris for axis in ("x", "y")),
            "cos_yaw", "sin_yaw", *(f"robot_to_block{i}" for i in debris),
            *(f"block{i}_to_goal" for i in debris), *(("opening",) * self.body.has_fingers),
        )  # fmt: skip

    @property
    def state_units(self) -> tuple[str, ...]:
        """(S,) units of the privileged state."""
        places = 2 + 2 * self.blocks
        return ("m",) * places + ("1",) * (len(self.state_names) - places)

    def draw_start(self, rng: np.random.Generator) -> PlanarScene:
        """Return the one start, or debris in a row at a random height and random places."""
        if self.layout == "demo":
            return super().draw_start(rng)
        height = rng.uniform(-0.1, 0.5)
        places = np.arange(-0.8, 0.8, 0.48)
        row = rng.choice(places, size=self.blocks, replace=False)
        blocks = np.stack([row, np.full(self.blocks, height)], axis=1)
        return PlanarScene(np.array([*self.config.robot, 0.0]), blocks)

    def observe(self, scene: PlanarScene) -> NDArray[np.float64]:
        """Return the state (S,) of a scene."""
        x, y, yaw = scene.robot
        reach = np.linalg.norm(scene.blocks - [x, y], axis=1) / DIAGONAL
        to_top = np.abs(1 - scene.blocks[:, 1]) / DIAGONAL
        opening = [] if scene.opening is None else [scene.opening]
        debris = scene.blocks.ravel()
        return np.array([x, y, *debris, np.cos(yaw), np.sin(yaw), *reach, *to_top, *opening])

    def robot_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x, y and heading (..., 3) of the robot in states (..., S)."""
        after = 2 + 2 * self.blocks
        yaw = np.arctan2(states[..., after + 1], states[..., after])
        return np.concatenate([states[..., :2], yaw[..., None]], axis=-1)

    def blocks_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x and y (..., 3, 2) of the debris in states (..., S)."""
        places = states[..., 2 : 2 + 2 * self.blocks]
        return places.reshape(*states.shape[:-1], self.blocks, 2)

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return the dense reward, minus the mean distance to y = 1 of debris not yet above
        0.88, or the sparse one, the share above; both as the public package.

        :param start: not needed here.
        """
        height = self.blocks_of(self.checked(state))[:, 1]
        # Departs from the public package: there debris is in when its box is, whose angle the
        # public state does not have either
        if self.reward == "sparse":
            return float((height > ARRIVED).mean())
        return -float(np.where(height > ARRIVED, 0.0, np.abs(1 - height)).mean())

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether all debris ended above 0.88 m: wholly in the strip."""
        return bool((self.blocks_of(np.asarray(states)[-1])[:, 1] > ARRIVED).all())

    def rest_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what stands behind the positions (..., R) in states (..., S)."""
        return states[..., 2 + 2 * self.blocks :]
