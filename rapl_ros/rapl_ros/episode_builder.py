"""Puts episodes together from images, states, actions and joints; knows neither ROS nor disks."""

from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rapl_core.episodes.joints import JointTrack
from rapl_core.errors import ShapeError
from rapl_core.types import Episode
from rapl_ros.spare_images import SpareImages
from rapl_ros.wire import Command, Instant, JoinKey

Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True)
class BuilderLimits:
    """How long and how much the builder waits for."""

    image_deadline_s: float = 5.0
    """Wall time after an episode's last state in which its images and actions must arrive."""
    state_deadline_s: float = 30.0
    """Wall time without a state after which an unfinished episode is given up; pending states are
    repeated every second."""
    spare_images: int = 1024
    """Images kept whose state has not come, and as many joints and actions; the oldest go first."""
    spare_megabytes: int = 128
    """Of these images together."""
    spare_s: float = 10.0
    """Wall time for which they are kept."""


@dataclass(frozen=True)
class Joints:
    """The robot's joints at one instant."""

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    """(J,) rad and m."""
    velocities: NDArray[np.float64]
    """(J,) rad/s and m/s."""


@dataclass
class Recording:
    """What has come of one episode so far."""

    first: Instant
    latest: Instant
    heard_s: float
    """When its latest state came, on the caller's steady clock."""
    instants: dict[int, Instant] = field(default_factory=dict)
    frames: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    commands: dict[int, Command] = field(default_factory=dict)
    joints: dict[int, Joints] = field(default_factory=dict)

    def missing(self) -> str:
        """What a finished episode lacks, or an empty string."""
        steps = self.latest.step + 1
        for name, have, expected in (
            ("state", self.instants, steps),
            ("image", self.frames, steps),
            ("action", self.commands, steps - 1),
        ):
            lacking = [step for step in range(expected) if step not in have]
            if lacking:
                count = f"{len(lacking)} of {expected} missing"
                return f"{name} missing at step {lacking[0]} ({count})"
        return ""

    @property
    def awaits_joints(self) -> bool:
        """Whether joints have come, and those of the last state have not."""
        return bool(self.joints) and self.latest.step not in self.joints

    def episode(self, task: str) -> Episode:
        """The complete episode.

        :raises ShapeError: if its images or states are not all of one size, or it has no step.
        """
        steps = self.latest.step
        frames = [self.frames[step] for step in range(steps + 1)]
        instants = [self.instants[step] for step in range(steps + 1)]
        commands = [self.commands[step] for step in range(steps)]
        name = f"episode {self.first.episode_id}"
        if not commands:
            raise ShapeError(f"{name} has no transition")
        _check_alike(f"images of {name}", [frame.shape for frame in frames])
        _check_alike(f"states of {name}", [instant.values.shape for instant in instants])
        _check_alike(f"actions of {name}", [command.values.shape for command in commands])
        truth = [instant.human_reward for instant in instants]
        has_truth = all(reward is not None for reward in truth)
        return Episode(
            episode_id=self.first.episode_id,
            task=task,
            world=self.first.world,
            purpose=self.first.purpose,
            controller=self.first.controller,
            frames=np.stack(frames),  # (T + 1, H, W, 3)
            states=np.stack([instant.values for instant in instants]),  # (T + 1, S)
            actions=np.clip([command.values for command in commands], -1.0, 1.0),  # (T, A)
            stamps_ns=np.array([instant.stamp_ns for instant in instants], dtype=np.int64),
            human_rewards=np.array(truth, dtype=np.float64) if has_truth else None,
            success=self.latest.success,
            behaviour=commands[0].behaviour,
        )

    def joint_track(self) -> JointTrack | None:
        """Joints at all instants; None if any is missing."""
        steps = self.latest.step + 1
        if any(step not in self.joints for step in range(steps)):
            return None
        joints = [self.joints[step] for step in range(steps)]
        if any(joint.names != joints[0].names for joint in joints):
            return None
        if any({len(j.positions), len(j.velocities)} != {len(j.names)} for j in joints):
            return None  # many drivers leave the velocities out
        return JointTrack(
            names=joints[0].names,
            positions=np.stack([joint.positions for joint in joints]),  # (T + 1, J)
            velocities=np.stack([joint.velocities for joint in joints]),  # (T + 1, J)
        )


@dataclass(frozen=True)
class LostEpisode:
    """An episode that should have been recorded and cannot be."""

    latest: Instant
    reason: str


Outcome = Recording | LostEpisode


class EpisodeBuilder:
    """Joins what arrives in any order; each episode to be recorded ends in exactly one outcome.

    Time is the caller's steady clock, in seconds.

    :param purposes: episodes of other purposes are passed over.
    """

    def __init__(self, purposes: Collection[str], limits: BuilderLimits | None = None) -> None:
        self.purposes = frozenset(purposes)
        self.limits = limits or BuilderLimits()
        self._open: dict[str, Recording] = {}
        self._done: OrderedDict[str, None] = OrderedDict()
        self._awaited: dict[JoinKey, tuple[str, int]] = {}
        self._awaited_joints: dict[JoinKey, tuple[str, int]] = {}
        self._spare = SpareImages(
            self.limits.spare_images, self.limits.spare_megabytes, self.limits.spare_s
        )
        self._unwanted: OrderedDict[JoinKey, None] = OrderedDict()
        self._spare_joints: OrderedDict[JoinKey, Joints] = OrderedDict()
        self._early: OrderedDict[tuple[str, int], Command] = OrderedDict()

    @property
    def open_episodes(self) -> list[str]:
        """Ids of the episodes that have no outcome yet, oldest first."""
        return list(self._open)

    def add_state(self, instant: Instant, now_s: float) -> list[Outcome]:
        """Take a state; repeats are harmless."""
        if instant.purpose not in self.purposes or instant.episode_id in self._done:
            self._pass_over(instant)
            return []
        outcomes = self._lose_superseded(instant)
        recording = self._open.get(instant.episode_id)
        if recording is None:
            recording = self._open[instant.episode_id] = Recording(instant, instant, now_s)
            for early in [key for key in self._early if key[0] == instant.episode_id]:
                recording.commands[early[1]] = self._early.pop(early)
        recording.heard_s = now_s
        if instant.step in recording.instants:
            return outcomes
        recording.instants[instant.step] = instant
        if instant.step > recording.latest.step:
            recording.latest = instant
        frame = self._spare.pop(instant.image)
        if frame is None:
            self._awaited[instant.image] = (instant.episode_id, instant.step)
        else:
            recording.frames[instant.step] = frame
        joints = self._spare_joints.pop(instant.key, None)
        if joints is None:
            self._awaited_joints[instant.key] = (instant.episode_id, instant.step)
        else:
            recording.joints[instant.step] = joints
        return outcomes + self._finish(recording)

    def add_image(self, key: JoinKey, frame: NDArray[np.uint8], now_s: float) -> list[Outcome]:
        """Take an image (H, W, 3)."""
        if key in self._unwanted:
            del self._unwanted[key]
            return []
        place = self._awaited.pop(key, None)
        if place is None:
            self._spare.keep(key, frame, now_s)
            return []
        recording = self._open[place[0]]
        recording.frames[place[1]] = frame
        return self._finish(recording)

    def add_action(self, command: Command) -> list[Outcome]:
        """Take an action; of two for the same state the first counts, as in the simulator.

        The first action of an episode may come before the state that it answers.
        """
        recording = self._open.get(command.episode_id)
        if recording is None:
            place = (command.episode_id, command.step)
            if command.episode_id not in self._done and place not in self._early:
                _keep(self._early, place, command, self.limits.spare_images)
            return []
        if command.controller != recording.first.controller:
            return []
        recording.commands.setdefault(command.step, command)
        return self._finish(recording)

    def add_joints(self, key: JoinKey, joints: Joints) -> list[Outcome]:
        """Take the joints of the state with ``key``."""
        if key in self._unwanted:
            return []
        place = self._awaited_joints.pop(key, None)
        if place is None:
            _keep(self._spare_joints, key, joints, self.limits.spare_images)
            return []
        recording = self._open[place[0]]
        recording.joints[place[1]] = joints
        return self._finish(recording)

    def expire(self, now_s: float) -> list[Outcome]:
        """Give up the episodes whose deadline has passed, and images that are too old."""
        self._spare.expire(now_s)
        outcomes: list[Outcome] = []
        for recording in list(self._open.values()):
            silent_s = now_s - recording.heard_s
            if recording.latest.is_last:
                if silent_s <= self.limits.image_deadline_s:
                    continue
                missing = recording.missing()
                if missing:
                    outcomes.append(self._lose(recording, missing))
                else:  # only joints are, and nothing needs them
                    self._close(recording)
                    outcomes.append(recording)
            elif silent_s > self.limits.state_deadline_s:
                outcomes.append(self._lose(recording, f"stopped at step {recording.latest.step}"))
        return outcomes

    def _lose_superseded(self, instant: Instant) -> list[Outcome]:
        """A world has one episode at a time: a new one ends the unfinished one."""
        return [
            self._lose(other, f"stopped at step {other.latest.step}: {instant.episode_id} began")
            for other in list(self._open.values())
            if other.first.world == instant.world
            and other.first.episode_id != instant.episode_id
            and not other.latest.is_last
        ]

    def _pass_over(self, instant: Instant) -> None:
        if self._spare_joints.pop(instant.key, None) is None:
            self._ignore(instant.key)
        if self._spare.pop(instant.image) is None:
            self._ignore(instant.image)

    def _ignore(self, key: JoinKey) -> None:
        _keep(self._unwanted, key, None, 2 * self.limits.spare_images)

    def _finish(self, recording: Recording) -> list[Outcome]:
        if not recording.latest.is_last or recording.missing() or recording.awaits_joints:
            return []
        self._close(recording)
        return [recording]

    def _lose(self, recording: Recording, reason: str) -> LostEpisode:
        self._close(recording)
        return LostEpisode(recording.latest, reason)

    def _close(self, recording: Recording) -> None:
        episode_id = recording.first.episode_id
        del self._open[episode_id]
        for instant in recording.instants.values():
            if self._awaited.pop(instant.image, None) is not None:
                self._ignore(instant.image)
            if self._awaited_joints.pop(instant.key, None) is not None:
                self._ignore(instant.key)
        _keep(self._done, episode_id, None, self.limits.spare_images)


def _keep(store: "OrderedDict[Key, Value]", key: Key, value: Value, size: int) -> None:
    store[key] = value
    while len(store) > size:
        store.popitem(last=False)


def _check_alike(name: str, shapes: list[tuple[int, ...]]) -> None:
    different = sorted(set(shapes))
    if len(different) > 1:
        raise ShapeError(f"{name} are not of one shape: {', '.join(map(str, different))}")
