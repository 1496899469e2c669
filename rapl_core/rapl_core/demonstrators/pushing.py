"""Ways of pushing two cubes on the table, as sequences of phases."""

import numpy as np

from rapl_core.demonstrators.phases import Phase, Point, State
from rapl_core.tasks.tabletop import TabletopConfig

GRIPPER = slice(7, 9)
CUBES = (slice(10, 12), slice(13, 15))

TOUCH = 0.012
"""m between fork and cube's side when the gripper is said to be behind it."""
CLEARANCE = 0.095
"""m between gripper and cube centres, sideways, at which the fork passes a cube."""
FORK_REACH = {"panda": 0.05, "iiwa": 0.045}
"""m from the gripper's middle to the outer side of its fork in a sideways push, by robot:
0.059 and 0.049, less what a cube goes on further."""
FINGER = 0.02
"""m from the gripper's centre to the front of its fingers, about."""


class Pusher:
    """Makes phases for one scene.

    :param config: sizes of the scene.
    :param rng: draws what differs from one video to the next.
    """

    def __init__(self, config: TabletopConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.rng = rng
        self.behind = config.cube_half + FINGER + TOUCH
        self.fork_reach = FORK_REACH[config.robot]
        self.pace = float(rng.uniform(0.7, 1.0))
        self.depth = float(rng.uniform(0.03, 0.07))
        """m behind the goal's near edge at which pushing stops."""

    def go_behind(self, cube: int) -> list[Phase]:
        """Retreat behind what is in the way, go sideways, and stand behind one cube."""
        own, other = CUBES[cube], CUBES[1 - cube]

        def line(state: State) -> float:
            in_way = state[other][0] < self.config.goal_near - self.config.cube_half
            rear = min(state[own][0], state[other][0]) if in_way else state[own][0]
            return float(rear - self.behind - 0.02)

        def back(state: State) -> Point:
            return np.array([line(state), state[GRIPPER][1]])

        def aside(state: State) -> Point:
            return np.array([line(state), state[own][1]])

        return [
            Phase(back, lambda s: s[GRIPPER][0] <= line(s) + 0.015, 16),
            Phase(aside, lambda s: abs(s[GRIPPER][1] - s[own][1]) < 0.01, 14),
        ]

    def push_forward(self, cube: int, until: float | None = None) -> list[Phase]:
        """Push a cube from behind until its centre is at ``until``, by default in the goal."""
        own = CUBES[cube]
        end = self.config.goal_near + self.depth if until is None else until
        return [
            Phase(
                lambda s: np.array([end, s[own][1]]),
                lambda s: s[own][0] >= end - 0.005, 40, self.pace,
            )
        ]  # fmt: skip

    def push_column(self, rear: int) -> list[Phase]:
        """Push the rear cube, and with it the one in front, until the rear one is in the goal."""
        return self.push_forward(rear, self.config.goal_near + 0.7 * self.depth)

    def push_pair(self) -> list[Phase]:
        """Stand behind the middle of two cubes that are side by side, and push both."""
        one, two = CUBES
        end = self.config.goal_near + self.depth

        def middle(state: State) -> float:
            return float((state[one][1] + state[two][1]) / 2)

        def rear(state: State) -> float:
            return float(min(state[one][0], state[two][0]) - self.behind - 0.02)

        return [
            Phase(
                lambda s: np.array([rear(s), s[GRIPPER][1]]),
                lambda s: s[GRIPPER][0] <= rear(s) + 0.015, 16,
            ),
            Phase(
                lambda s: np.array([rear(s), middle(s)]),
                lambda s: abs(s[GRIPPER][1] - middle(s)) < 0.008, 14,
            ),
            Phase(
                lambda s: np.array([end, middle(s)]),
                lambda s: min(s[one][0], s[two][0]) >= end - 0.005, 40, self.pace,
            ),
        ]  # fmt: skip

    def slide_beside(self, cube: int, other: int, gap: float = 0.0) -> list[Phase]:
        """Push a cube sideways until it stands ``gap`` m beside the other, 0: in line with it."""
        own, line = CUBES[cube], CUBES[other]
        offset = float(self.rng.uniform(-0.012, 0.012))

        def side(state: State) -> float:
            return float(np.sign(state[own][1] - state[line][1]) or 1.0)

        outer = CLEARANCE + 0.005
        lateral = self.config.cube_half + self.fork_reach

        def out(state: State) -> Point:
            back = min(state[GRIPPER][0], state[own][0] - self.behind - 0.02)
            return np.array([back, state[own][1] + side(state) * outer])

        def level(state: State) -> Point:
            return np.array([state[own][0], state[own][1] + side(state) * outer])

        start_side: list[float] = []

        def press(state: State) -> Point:
            start_side[:] = start_side or [side(state)]
            goal_y = state[line][1] + offset + start_side[0] * (gap + lateral)
            return np.array([state[own][0], goal_y])

        def in_line(state: State) -> bool:
            first = start_side[0] if start_side else side(state)
            return bool(first * (state[own][1] - state[line][1] - offset) < gap + 0.008)

        def leave(state: State) -> Point:
            first = start_side[0] if start_side else side(state)
            return np.array([state[GRIPPER][0], state[own][1] + first * (outer + 0.01)])

        return [
            Phase(out, lambda s: abs(s[GRIPPER][1] - out(s)[1]) < 0.012, 14),
            Phase(level, lambda s: s[GRIPPER][0] > s[own][0] - 0.012, 10),
            Phase(press, in_line, 14, self.pace),
            Phase(leave, lambda s: abs(s[GRIPPER][1] - s[own][1]) > outer - 0.012, 3),
        ]

    def move_to(self, x: float, y: float, patience: int = 14, pace: float = 1.0) -> Phase:
        """Go straight to a point of the table."""
        point = np.array([x, y])
        return Phase(
            lambda s: point, lambda s: bool(np.abs(s[GRIPPER] - point).max() < 0.012),
            patience, pace,
        )  # fmt: skip

    def rear(self, state: State) -> int:
        """Return which cube stands nearer to the robot."""
        return int(state[CUBES[0]][0] > state[CUBES[1]][0])

    def free_lane(self, state: State) -> float:
        """Return the y at which a push touches neither cube."""
        low, high = self.config.gripper_area[2:]
        lanes = np.linspace(low + 0.01, high - 0.01, 25)
        cubes = np.array([state[c][1] for c in CUBES])
        room = np.abs(lanes[:, None] - cubes).min(axis=1)
        free = lanes[room > CLEARANCE + 0.01]
        return float(self.rng.choice(free)) if len(free) else float(lanes[room.argmax()])
