"""What a planar robot that drives and turns can do: drive somewhere, push blocks somewhere."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rapl_core.tasks.xmagical import PlanarTask

State = NDArray[np.float64]
Point = NDArray[np.float64]

TURN_GAIN = 0.6
"""Share of an angle that is turned within a control period."""
NEAR = 0.05
"""m at which a place counts as reached."""


@dataclass(frozen=True)
class View:
    """A state as a skill sees it."""

    robot: Point
    """(2,) m."""
    heading: float
    """rad, 0 is up the picture."""
    blocks: NDArray[np.float64]
    """(N, 2) m."""

    def to(self, point: Point) -> tuple[float, float]:
        """Return the distance in m and the bearing in rad to the left, within [-pi, pi)."""
        offset = point - self.robot
        return float(np.hypot(*offset)), wrapped(direction(offset) - self.heading)


@dataclass(frozen=True)
class Command:
    """What the robot shall do in a control period."""

    speed: float = 0.0
    """m/s."""
    turn: float = 0.0
    """rad to the left within the period."""
    close: float = -1.0
    """Action of the fingers."""


class Skill(Protocol):
    """Something that takes a while."""

    patience: int
    """Steps after which it is given up."""

    def command(self, view: View) -> Command | None:
        """Return what to do; None when it is done."""


def direction(offset: Point) -> float:
    """Return the heading of (2,) in rad, 0 is up the picture."""
    return float(np.arctan2(-offset[0], offset[1]))


def wrapped(angle: float) -> float:
    """Return an angle within [-pi, pi)."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


@dataclass
class DriveTo:
    """Drive to a place, around blocks, forwards or backwards as is nearer."""

    target: Callable[[View], Point]
    clearance: float
    """m from a block's centre at which the robot passes it."""
    pace: float = 0.8
    patience: int = 25
    avoid: bool = True
    """Whether to go around blocks."""

    def command(self, view: View) -> Command | None:
        """Return speed and turn towards the target or the way around a block."""
        target = self.target(view)
        if np.hypot(*(target - view.robot)) < NEAR:
            return None
        return drive(view, self._detour(view, target) if self.avoid else target, self.pace)

    def _detour(self, view: View, target: Point) -> Point:
        way = target - view.robot
        length = float(np.hypot(*way))
        ahead = way / length
        for block in view.blocks[np.argsort(np.linalg.norm(view.blocks - view.robot, axis=1))]:
            along = float(np.clip((block - view.robot) @ ahead, 0, length))
            miss = view.robot + along * ahead - block
            wanted = min(self.clearance, float(np.hypot(*(target - block))) - 0.02)
            if along > 0 and np.hypot(*miss) < wanted:
                side = np.array([-ahead[1], ahead[0]])
                side = side if side @ miss >= 0 else -side
                corner = block + 1.15 * self.clearance * side
                room = 1.0 - 0.1
                if np.abs(corner).max() > room:  # no way between block and wall
                    corner = block - 1.15 * self.clearance * side
                return np.asarray(corner)
        return target


def drive(view: View, target: Point, pace: float, reverse: bool = True) -> Command:
    """Return a step towards a place, turning first where it lies aside."""
    distance, bearing = view.to(target)
    sign = 1.0
    if reverse and abs(bearing) > np.pi / 2:
        sign, bearing = -1.0, wrapped(bearing + np.pi)
    speed = min(pace, 8 * distance) * max(0.0, np.cos(bearing)) ** 3
    return Command(sign * speed, TURN_GAIN * bearing)


@dataclass
class Wait:
    """Stand still for some steps."""

    patience: int

    def command(self, view: View) -> Command | None:
        """Return nothing to do."""
        return Command()


@dataclass
class Back:
    """Drive backwards for some steps."""

    steps: int = 3
    pace: float = 0.7
    patience: int = 10

    def command(self, view: View) -> Command | None:
        """Return a step back."""
        self.steps -= 1
        return Command(-self.pace) if self.steps >= 0 else None


@dataclass
class Push:
    """Push blocks, seen as one, to a place: stand behind them, drive, and begin anew when lost.

    :param blocks: which.
    :param target: where their middle shall go.
    """

    blocks: tuple[int, ...]
    target: Callable[[View], Point]
    reach: float
    """m from the robot's centre to the foremost of it."""
    gap: float
    """m between that and a block where the robot stands before it pushes: room to turn."""
    half_width: float
    """m within which the robot's front holds a block."""
    extent: float
    """m from the blocks' middle to the side that is pushed."""
    clearance: float
    pace: float = 0.7
    patience: int = 60
    grip: bool = False
    done: Callable[[View], bool] | None = None
    aside: float = 0.0
    """m to the right of the robot's middle at which its front meets the blocks."""
    pushing: bool = False
    aim: float | None = None

    def command(self, view: View) -> Command | None:
        """Return a step of standing behind, facing or pushing."""
        middle = view.blocks[list(self.blocks)].mean(axis=0)
        way = self.target(view) - middle
        length = float(np.hypot(*way))
        if self.done(view) if self.done else length < NEAR:
            return None
        if self.aim is None or length > 0.15:  # nearer, the direction jumps about
            self.aim = direction(way)
        aim = self.aim
        ahead = np.array([-np.sin(view.heading), np.cos(view.heading)])
        offset = middle - view.robot
        forward, right = float(offset @ ahead), float(offset @ [ahead[1], -ahead[0]]) - self.aside
        error = wrapped(aim - view.heading)
        standoff = self.reach + self.extent + self.gap
        slack = 1.4 if self.pushing else 1.0
        self.pushing = (
            0 < forward < standoff + 0.03 * slack
            and abs(right) < slack * self.half_width
            and abs(error) < 0.5 * slack
        )
        if self.pushing:
            turn = 0.35 * error - 0.9 * right
            speed = min(self.pace, 8 * length + 0.1) * max(0.3, np.cos(2 * error))
            return Command(speed, float(np.clip(turn, -0.2, 0.2)), 1.0 if self.grip else -1.0)
        back = np.array([np.sin(aim), -np.cos(aim)])
        stand = middle + back * standoff - self.aside * np.array([np.cos(aim), np.sin(aim)])
        if np.hypot(*(stand - view.robot)) < NEAR + 0.01:
            if abs(error) < 0.12:
                return Command(0.5, error)
            return Command(0.0, float(error))
        approach = DriveTo(lambda _: stand, self.clearance, pace=0.8)
        return approach.command(view) or Command(0.0, error)


class SkillFollower:
    """Acts skills one after the other and then stands still."""

    def __init__(self, task: PlanarTask, skills: Sequence[Skill]) -> None:
        self._task = task
        self._skills = list(skills)
        self._spent = 0

    def act(self, state: State) -> NDArray[np.float64]:
        """Return the action (A,) in [-1, 1] at a state (S,)."""
        task = self._task
        robot = task.robot_of(state)
        view = View(robot[:2], float(robot[2]), task.blocks_of(state))
        while self._skills:
            skill = self._skills[0]
            command = skill.command(view) if self._spent < skill.patience else None
            if command is not None:
                self._spent += 1
                return self._action(command)
            self._skills.pop(0)
            self._spent = 0
        return self._action(Command())

    def _action(self, command: Command) -> NDArray[np.float64]:
        config = self._task.config
        rate = command.turn / self._task.period_s / config.turn_rate
        turn = float(np.clip(rate, -1, 1)) * config.full_turn
        action = [command.speed, turn, command.close]
        return np.array(action[: len(self._task.action_names)])
