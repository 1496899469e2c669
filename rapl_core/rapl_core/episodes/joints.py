"""The robot's joints during an episode."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.types import check_shape


@dataclass(frozen=True)
class JointTrack:
    """Joints at the T + 1 instants of an episode; optional, for rviz and for people."""

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    """(T + 1, J) rad or m."""
    velocities: NDArray[np.float64]
    """(T + 1, J) rad/s or m/s."""

    def __post_init__(self) -> None:
        shape = (len(self.positions), len(self.names))
        check_shape("joint positions", self.positions, shape)
        check_shape("joint velocities", self.velocities, shape)

    def check_instants(self, instants: int) -> None:
        """Raise ShapeError unless there are joints for so many instants."""
        if len(self.positions) != instants:
            raise ShapeError(f"joints of {len(self.positions)} instants, expected {instants}")
