"""Ways of moving blocks in the X-MAGICAL arena, as sequences of skills."""

from collections.abc import Callable, Sequence

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.planar_skills import (
    DriveTo,
    Point,
    Push,
    Skill,
    SkillFollower,
    State,
    View,
)
from rapl_core.tasks.xmagical import PlanarTask

ROOM = 0.03
"""m that a body keeps from what it passes."""


class Mover:
    """Makes skills for one episode.

    :param rng: draws what differs from one video to the next.
    """

    def __init__(self, task: PlanarTask, rng: np.random.Generator) -> None:
        self.task = task
        self.rng = rng
        self.half = task.config.block_half
        self.pace = float(rng.uniform(0.55, 0.8))
        body = task.body
        self.is_wide = body.width > 0.5
        """Covers more than one block."""
        self._reach = 0.39 if body.has_fingers else body.front
        self._gap = 0.3 if self.is_wide else 0.08
        self._hold = 0.06 if body.has_fingers else 0.42 * min(body.width, 0.6)
        # past a long stick's ends there is no room: it drives with its side along
        across = max(body.width, 2 * self._reach) / 2
        self._clearance = self.half * 1.41 + min(across, 0.32) + ROOM
        self.retreat = 5 if self.is_wide else 3
        """Steps backwards after a push: room to turn."""
        self.goal_y = task.config.goal_near + self.half + float(rng.uniform(0.02, 0.07))
        """m where a block is pushed to."""
        self.grip = bool(rng.random() < 0.5)

    def push(
        self,
        block: int,
        target: Callable[[View], Point],
        done: Callable[[View], bool] | None = None,
        patience: int = 60,
        aside: float = 0.0,
    ) -> Push:
        """Push one block to a place.

        :param aside: m to the right of the robot's middle at which its front meets the block.
        """
        return Push(
            (block,), target, self._reach, self._gap, self._hold, self.half, self._clearance,
            self.pace, patience, self.grip, done, aside,
        )  # fmt: skip

    def push_up(self, block: int, until: float | None = None, aside: float = 0.0) -> Push:
        """Push one block straight up, by default into the strip."""
        end = self.goal_y if until is None else until
        return self.push(
            block,
            lambda view: np.array([view.blocks[block][0], end + 0.1]),
            lambda view: bool(view.blocks[block][1] >= end),
            aside=aside,
        )

    def push_all_up(self, blocks: tuple[int, ...], until: float | None = None) -> Push:
        """Push several blocks straight up at once, from below their middle."""
        end = self.goal_y if until is None else until

        def middle(view: View) -> Point:
            return np.asarray(view.blocks[list(blocks)].mean(axis=0))

        return Push(
            blocks,
            lambda view: np.array([middle(view)[0], end + 0.3]),
            self._reach, self._gap, self._hold, self.half, self._clearance,
            self.pace, 60, False,
            lambda view: bool(view.blocks[list(blocks), 1].min() >= end),
        )  # fmt: skip

    def bring_beside(self, block: int, other: int) -> Push:
        """Push a block sideways until it stands beside another."""
        apart = 2 * self.half + 0.005
        return self.push(
            block,
            lambda view: (
                view.blocks[other]
                + [apart * _side(view.blocks[block][0] - view.blocks[other][0]), 0.0]
            ),
            lambda view: bool(
                np.linalg.norm(view.blocks[block] - view.blocks[other]) < 1.22 * apart
            ),
            patience=45,
        )

    def bring_below(self, block: int, other: int) -> Push:
        """Push a block sideways until it stands below another's column."""
        return self.push(
            block,
            lambda view: np.array([view.blocks[other][0], view.blocks[block][1]]),
            lambda view: bool(abs(view.blocks[block][0] - view.blocks[other][0]) < 0.03),
            patience=45,
        )

    def drive_to(self, x: float, y: float, patience: int = 25, avoid: bool = True) -> DriveTo:
        """Drive to a place."""
        point = np.array([x, y])
        return DriveTo(lambda view: point, self._clearance, self.pace, patience, avoid)

    def free_lane(self, view_blocks: np.ndarray) -> float:
        """Return the x at which driving up touches no block."""
        edge = self.task.config.arena_half - min(self.task.body.width, 0.6) / 2 - ROOM
        lanes = np.linspace(-edge, edge, 25)
        room = np.abs(lanes[:, None] - view_blocks[:, 0]).min(axis=1)
        free = lanes[room > self._clearance]
        return float(self.rng.choice(free)) if len(free) else float(lanes[room.argmax()])


def _side(offset: float) -> float:
    return float(np.sign(offset)) or 1.0


Plan = Callable[[Mover, State], list[Skill]]
Row = tuple[str, Plan, float, bool]
"""Name, plan, share of the pool, preferred."""


def stall(mover: Mover, state: State) -> list[Skill]:
    """Drive a little and stop."""
    x, y = mover.rng.uniform(-0.8, [0.8, -0.3])
    return [mover.drive_to(x, y, 12)]


def nothing(mover: Mover, state: State) -> list[Skill]:
    """Follow no plan; random motion alone moves the robot."""
    return []


def planar_behaviours(
    task: PlanarTask, rows: Sequence[Row], telling: tuple[str, str]
) -> tuple[Behaviour, ...]:
    """Return behaviours from their rows, with shares that add up to 1.

    :param telling: the preferred and the disliked one that stand for all.
    """
    whole = sum(share for _, _, share, _ in rows)
    unit = (1.0, task.config.full_turn, 1.0)[: len(task.action_names)]

    def behaviour(name: str, plan: Plan, share: float, preferred: bool) -> Behaviour:
        def begin(rng: np.random.Generator, state: State) -> SkillFollower:
            return SkillFollower(task, plan(Mover(task, rng), state))

        wander = 1.0 if plan is nothing else 0.0
        return Behaviour(name, begin, share / whole, preferred, wander, name in telling, unit)

    return tuple(behaviour(*row) for row in rows)
