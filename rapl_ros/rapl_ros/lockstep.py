"""Who drives which world and when they step; knows worlds and time, not ROS.

All worlds step together, when each that is under way has the action that answers its state. A
world that rests waits for nobody.
"""

import re
import secrets
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.simulation.simulation import STREAMS, Simulation, Snapshot, episode_rng
from rapl_ros import topics
from rapl_ros.time_shares import TimeShares
from rapl_ros.wire import Command, Instant, JoinKey

NODE_NAME = r"[A-Za-z_][A-Za-z0-9_]*"


@dataclass(frozen=True)
class Assignment:
    """What a world does until it is told otherwise."""

    purpose: str
    controller: str
    """Node whose actions count."""
    episodes: int
    """Then the world rests; 0: endless."""
    first_episode: int
    """Number of the first one."""
    seed: int
    token: str = field(default_factory=lambda: secrets.token_hex(4))
    """Makes ids unique across restarts and repeated resets."""

    def __post_init__(self) -> None:
        if self.purpose not in STREAMS:
            raise UnknownNameError("purpose", self.purpose, STREAMS)
        if not self.controller:
            raise RaplError(f"nobody is named to control the episodes to {self.purpose}")
        if not re.fullmatch(NODE_NAME, self.controller):
            raise RaplError(
                f"controller {self.controller!r} is no name of a node: letters, digits and "
                "underscores, no digit first"
            )

    def episode_id(self, world: int, number: int) -> str:
        """Id of an episode: sorted, they are in an order that follows from the seed."""
        return f"{self.purpose}-s{self.seed}-w{world}-{number:06d}-{self.token}"


@dataclass(frozen=True)
class Scene:
    """All that is published of one instant of a world."""

    instant: Instant
    joint_positions: NDArray[np.float64]
    """(J,) rad and m."""
    joint_velocities: NDArray[np.float64]
    """(J,) rad/s and m/s."""
    picture: NDArray[np.uint8] | None
    """(H, W, 3); None where pictures are not drawn."""


class _World:
    """One world under its assignment."""

    def __init__(self, index: int) -> None:
        self.index = index
        self.assignment: Assignment | None = None
        self.number = 0
        self.scene: Scene | None = None
        self.action: Command | None = None

    @property
    def is_over(self) -> bool:
        return self.scene is not None and self.scene.instant.is_last

    @property
    def rests(self) -> bool:
        if self.assignment is None:
            return True
        begun = self.number + 1 - self.assignment.first_episode
        return self.is_over and 0 < self.assignment.episodes <= begun

    @property
    def waits(self) -> bool:
        """For its controller."""
        return not self.rests and not self.is_over and self.action is None


class Lockstep:
    """Drives the worlds of one simulation.

    :param render: whether scenes have pictures.
    """

    def __init__(self, simulation: Simulation, shares: TimeShares, render: bool = True) -> None:
        self._simulation = simulation
        self._shares = shares
        self._render = render
        self._worlds = [_World(index) for index in range(simulation.worlds)]

    def assign(
        self, worlds: Sequence[int], assignment: Assignment | None, stamp_ns: int
    ) -> list[Scene]:
        """Begin new episodes in ``worlds`` (empty: all) and return their first scenes.

        Episodes under way there stay incomplete.

        :param assignment: None lets the worlds rest.
        :param stamp_ns: instant of the scenes, later than any before.
        :raises RaplError: if a world does not exist.
        """
        chosen = list(dict.fromkeys(worlds)) or list(range(len(self._worlds)))
        for index in chosen:
            if not 0 <= index < len(self._worlds):
                raise RaplError(f"world {index} does not exist: worlds are 0 to {self.last_world}")
        if assignment is None:
            for index in chosen:
                self._worlds[index].assignment = None
            return []
        first = assignment.first_episode
        return [self._begin(self._worlds[i], assignment, first, stamp_ns) for i in chosen]

    @property
    def last_world(self) -> int:
        """Index of the last world."""
        return len(self._worlds) - 1

    @property
    def controllers(self) -> set[str]:
        """Nodes that drive a world now."""
        return {w.assignment.controller for w in self._worlds if w.assignment and not w.rests}

    def offer(self, command: Command) -> str:
        """Take the action that answers a world's present state; else say why it is ignored.

        :return: empty when the action counts; otherwise the reason.
        """
        if not 0 <= command.world < len(self._worlds):
            return "unknown world"
        world = self._worlds[command.world]
        if world.assignment is None or world.scene is None or world.rests:
            return "world rests"
        instant = world.scene.instant
        if command.controller != instant.controller:
            return "other controller"
        if command.episode_id != instant.episode_id:
            return "other episode"
        if command.step != instant.step:
            return "other step"
        if instant.is_last:
            return "episode is over"
        if world.action is not None:
            return "answered already"
        if command.values.shape != (len(self._simulation.task.action_names),):
            return "wrong size"
        world.action = command
        return ""

    @property
    def is_ready(self) -> bool:
        """Whether every world under way can go on."""
        under_way = [world for world in self._worlds if not world.rests]
        return bool(under_way) and not any(world.waits for world in under_way)

    def pending(self) -> list[Scene]:
        """Scenes of the worlds that wait for their controller."""
        return [w.scene for w in self._worlds if w.waits and w.scene is not None]

    def advance(self, stamp_ns: int) -> Iterator[Scene]:
        """Step every world that has its action, begin the next episode of those that are over.

        Lazy, so that a scene is on its way while the next is drawn: take all of it.

        :param stamp_ns: instant of the scenes, later than any before.
        """
        for world in self._worlds:
            assignment = world.assignment
            if assignment is None or world.rests:
                continue
            if world.is_over:
                yield self._begin(world, assignment, world.number + 1, stamp_ns)
            elif world.action is not None:
                action, world.action = world.action, None
                with self._shares.of("physics"):
                    snapshot = self._simulation.step(world.index, action.values)
                yield self._show(world, assignment, snapshot, stamp_ns)

    def _begin(self, world: _World, assignment: Assignment, number: int, stamp_ns: int) -> Scene:
        world.assignment, world.number, world.action = assignment, number, None
        rng = episode_rng(assignment.seed, assignment.purpose, world.index, number)
        with self._shares.of("physics"):
            snapshot = self._simulation.reset(world.index, rng)
        return self._show(world, assignment, snapshot, stamp_ns)

    def _show(
        self, world: _World, assignment: Assignment, snapshot: Snapshot, stamp_ns: int
    ) -> Scene:
        picture = None
        if self._render:
            with self._shares.of("rendering", whole_process=True):
                picture = self._simulation.render(world.index)
        world.scene = Scene(
            instant=Instant(
                key=JoinKey(topics.world_frame(world.index), stamp_ns),
                image=JoinKey(topics.camera_frame(world.index), stamp_ns),
                world=world.index,
                episode_id=assignment.episode_id(world.index, world.number),
                purpose=assignment.purpose,
                controller=assignment.controller,
                step=snapshot.step,
                is_last=snapshot.is_last,
                terminated=snapshot.terminated,
                values=snapshot.state,
                human_reward=snapshot.human_reward,
                success=snapshot.success,
            ),
            joint_positions=snapshot.joint_positions,
            joint_velocities=snapshot.joint_velocities,
            picture=picture,
        )
        return world.scene
