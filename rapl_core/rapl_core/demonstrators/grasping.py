"""Ways of holding, carrying and releasing objects among others, as sequences of phases."""

import numpy as np

from rapl_core.demonstrators.phases import Phase, Point, State
from rapl_core.tasks.clutter import CUBES, GRIPPER, OPENING, PRISMS, ClutterConfig

NEAR, FAR = 0, 1
"""The prisms, by where they start."""
BEHIND = 0.045
"""m between the gripper and the rear side of what it is going to grasp."""
CLOSING = 7
"""Steps in which the fingers close on an object or open again, with some to spare."""
HELD = 0.028
"""m opening a finger below which something as wide as a prism or a cube is held."""
SLACK = 0.012
"""m that what is kept in place may stray."""
LANE = 0.072
"""m sideways between the middle of the open fork and what it must not touch, besides its half."""


def spot(state: State, thing: int) -> Point:
    """Return where an object's centre is on the table (2,), prisms first."""
    return state[10 + 3 * thing : 12 + 3 * thing]


class Grasper:
    """Makes phases for one scene.

    :param config: sizes of the scene.
    :param rng: draws what differs from one video to the next.
    """

    def __init__(self, config: ClutterConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self.pace = float(rng.uniform(0.75, 1.0))
        self.depth = float(rng.uniform(-0.005, 0.015))
        """m further into the goal than where all of the rear prism is inside."""
        self.hold = float(rng.uniform(0.005, 0.025))
        """m behind an object's centre at which it is held."""

    def half(self, thing: int) -> float:
        """Return half the length of an object."""
        return self.config.prism_half[0] if thing < PRISMS else self.config.cube_half

    def move(self, x: float | None, y: float | None, grip: float = 0.0, pace: float = 1.0) -> Phase:
        """Go to a point of the table; None keeps the coordinate as it is."""

        def target(state: State) -> Point:
            here = state[GRIPPER]
            return np.array([here[0] if x is None else x, here[1] if y is None else y])

        def done(state: State) -> bool:
            return bool(np.abs(target(state) - state[GRIPPER]).max() < 0.012)

        return Phase(target, done, 25, pace, grip)

    def stay(self, grip: float, steps: int = CLOSING) -> Phase:
        """Stay while the fingers close or open."""
        wanted = HELD if grip > 0 else self.config.finger_opening - 0.004

        def done(state: State) -> bool:
            closed = state[OPENING] < wanted
            return bool(closed if grip > 0 else state[OPENING] > wanted)

        return Phase(lambda s: s[GRIPPER].copy(), done, steps, grip=grip)

    def grasp(self, thing: int) -> list[Phase]:
        """Stand behind an object with open fingers, slide over it, close."""

        def line(state: State) -> float:
            rear = spot(state, thing)[0] - self.half(thing)
            others = [
                spot(state, other)[0] - self.half(other)
                for other in range(PRISMS + CUBES)
                if other != thing and self._between(state, other, spot(state, thing)[1])
            ]
            return float(min([rear, *others]) - BEHIND)

        def back(state: State) -> Point:
            return np.array([min(line(state), state[GRIPPER][0]), state[GRIPPER][1]])

        def aside(state: State) -> Point:
            return np.array([min(line(state), state[GRIPPER][0]), spot(state, thing)[1]])

        def over(state: State) -> Point:
            return spot(state, thing) - [self.hold, 0.0]

        return [
            Phase(back, lambda s: s[GRIPPER][0] <= line(s) + 0.015, 22, grip=-1.0),
            Phase(aside, lambda s: abs(s[GRIPPER][1] - spot(s, thing)[1]) < 0.008, 16, grip=-1.0),
            Phase(over, lambda s: s[GRIPPER][0] >= over(s)[0] - 0.008, 16, self.pace, -1.0),
            self.stay(1.0),
        ]

    def _between(self, state: State, other: int, lane: float) -> bool:
        """Whether an object stands where the fork passes on its way to a lane."""
        low, high = sorted((float(state[GRIPPER][1]), lane))
        y, ahead = spot(state, other)[1], spot(state, other)[0] < self.config.goal_near
        return bool(ahead and low - LANE < y < high + LANE)

    def carry(self, thing: int, x: float | None, y: float | None, patience: int = 25) -> Phase:
        """Carry a held object until its centre is there; None keeps the coordinate."""

        def wanted(state: State) -> Point:
            here = spot(state, thing)
            return np.array([here[0] if x is None else x, here[1] if y is None else y])

        def target(state: State) -> Point:
            return state[GRIPPER] + wanted(state) - spot(state, thing)

        def done(state: State) -> bool:
            return bool(np.abs(wanted(state) - spot(state, thing)).max() < 0.008)

        return Phase(target, done, patience, self.pace, 1.0)

    def deliver(self, thing: int, lane: float) -> list[Phase]:
        """Carry a held object along a lane into the goal and keep it where it then is."""
        kept: list[Point] = []

        def stay(state: State) -> Point:
            here = state[GRIPPER].copy()
            kept[:] = kept or [here]
            # a servo never arrives to the last millimetre, and would be driven on and on
            return here if np.abs(kept[0] - here).max() < SLACK else kept[0]

        return [
            self.carry(thing, self.goal(thing), lane, 40),
            Phase(stay, lambda s: False, self.config.horizon, grip=1.0),
        ]

    def goal(self, thing: int) -> float:
        """Return the x at which all of an object is in the goal, and some more."""
        return self.config.goal_near + self.half(thing) + self.depth

    def release(self) -> list[Phase]:
        """Open the fingers."""
        return [self.stay(-1.0)]
