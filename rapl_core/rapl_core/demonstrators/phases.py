"""A scripted behaviour as a sequence of phases: where the gripper goes, and until when."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

State = NDArray[np.float64]
Point = NDArray[np.float64]


@dataclass(frozen=True)
class Phase:
    """Go where ``target`` says, until ``done`` says so or ``patience`` steps have passed."""

    target: Callable[[State], Point]
    """state (S,) -> point of the table (2,) in m."""
    done: Callable[[State], bool]
    patience: int = 25
    pace: float = 1.0
    """Share of full speed."""
    grip: float = 0.0
    """What the fingers do meanwhile: 1 close, -1 open, 0 stay; only with ``fingers``."""


class PhaseFollower:
    """Follows phases one after the other and then holds still.

    :param phases: in order.
    :param reach: m that an action of 1 moves the gripper.
    :param position: indices of the gripper's x and y in the state.
    :param fingers: whether the action's third number is what the fingers do.
    """

    def __init__(
        self,
        phases: Sequence[Phase],
        reach: float,
        position: tuple[int, int],
        fingers: bool = False,
    ) -> None:
        self._phases = list(phases)
        self._reach = reach
        self._position = list(position)
        self._fingers = fingers
        self._index = 0
        self._spent = 0

    def act(self, state: State) -> NDArray[np.float64]:
        """Return the action (2,), or (3,) with fingers, in [-1, 1] at a state (S,)."""
        while self._index < len(self._phases):
            phase = self._phases[self._index]
            if self._spent < phase.patience and not phase.done(state):
                self._spent += 1
                move = (phase.target(state) - state[self._position]) / self._reach
                largest = max(1.0, float(np.abs(move).max()))
                action = np.asarray(phase.pace * move / largest, dtype=np.float64)
                return np.append(action, phase.grip) if self._fingers else action
            self._index += 1
            self._spent = 0
        return np.zeros(3 if self._fingers else 2)
