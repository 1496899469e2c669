"""What travels between nodes and has no type in rapl_core: frozen, validated, free of ROS."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rapl_core.errors import ShapeError
from rapl_core.types import EmbeddedEpisode, RewardTrace, check_episode_id


class JoinKey(NamedTuple):
    """Names one image: the key by which image, state and embedding are joined."""

    frame_id: str
    stamp_ns: int


@dataclass(frozen=True)
class Instant:
    """One control instant of one world (State.msg)."""

    key: JoinKey
    """Of the state itself: frame of its positions, instant measured."""
    image: JoinKey
    """Of the image that shows this instant."""
    world: int
    episode_id: str
    purpose: str
    controller: str
    step: int
    is_last: bool
    terminated: bool
    values: NDArray[np.float64]
    """(S,)"""
    human_reward: float | None = None
    """r* of arriving here; None where the truth is unknown (a real robot)."""
    success: bool | None = None

    def __post_init__(self) -> None:
        check_episode_id(self.episode_id)
        check_finite(f"state of episode {self.episode_id} at step {self.step}", self.values)

    @property
    def stamp_ns(self) -> int:
        """Instant measured; increases strictly per world."""
        return self.key.stamp_ns


@dataclass(frozen=True)
class Command:
    """The action that answers one instant (Action.msg)."""

    key: JoinKey
    """Copied from the state that it answers."""
    world: int
    episode_id: str
    step: int
    controller: str
    values: NDArray[np.float64]
    """(A,), each in [-1, 1]."""
    behaviour: str = ""

    def __post_init__(self) -> None:
        check_episode_id(self.episode_id)
        check_finite(f"action of episode {self.episode_id} at step {self.step}", self.values)


@dataclass(frozen=True)
class EmbeddedFrame:
    """One image through an encoder (Embedding.msg)."""

    image: JoinKey
    encoder: str
    version: str
    values: NDArray[np.float32]
    """(D,)"""

    def __post_init__(self) -> None:
        check_finite(f"embedding of {self.image.frame_id} at {self.image.stamp_ns} ns", self.values)


@dataclass(frozen=True)
class EpisodeReward:
    """Header part of Reward.msg: whose reward it is; the values are a RewardTrace."""

    key: JoinKey
    """Of the last state received."""
    episode_id: str
    world: int
    purpose: str
    encoder: str = ""
    version: str = ""


@dataclass(frozen=True)
class EpisodeRecord:
    """A complete episode that is on disk (EpisodeInfo.msg)."""

    key: JoinKey
    """Of its last state."""
    episode_id: str
    task: str
    world: int
    purpose: str
    controller: str
    behaviour: str
    steps: int
    uri: str
    """Relative to the run folder."""
    human_return: float | None = None
    """None where the truth is unknown."""
    success: bool | None = None


@dataclass(frozen=True)
class EmbeddingsAgain:
    """Recorded episodes through the encoder at work (EmbedEpisodes.srv)."""

    encoder: str
    version: str
    episodes: tuple[tuple[EpisodeRecord, EmbeddedEpisode], ...]
    missing: Mapping[str, str]
    """Why it could not be embedded, by episode id."""


@dataclass(frozen=True)
class RewardsAgain:
    """Rewards of recorded episodes by the encoder at work (RewardAgain.srv)."""

    encoder: str
    version: str
    rewards: tuple[tuple[EpisodeReward, RewardTrace], ...]
    missing: Mapping[str, str]
    """Why it could not be rewarded, by episode id."""


@dataclass(frozen=True)
class World:
    """What the simulator or the robot is (WorldInfo.msg)."""

    task: str
    worlds: int
    period_s: float
    max_steps: int
    """T: transitions of a full episode."""
    lockstep: bool
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    action_names: tuple[str, ...]
    camera_frames: tuple[str, ...]
    seed: int


def answer(instant: Instant, values: ArrayLike, behaviour: str = "") -> Command:
    """The command that answers ``instant`` with ``values`` (A,)."""
    return Command(
        key=instant.key,
        world=instant.world,
        episode_id=instant.episode_id,
        step=instant.step,
        controller=instant.controller,
        values=np.asarray(values, dtype=np.float64),
        behaviour=behaviour,
    )


@dataclass(frozen=True)
class LearnerMetrics:
    """How learning stands (Metrics.msg); NaN where unknown."""

    steps: int
    updates: int
    episodes: int
    dropped_episodes: int
    unrewarded_episodes: int
    steps_per_s: float
    reward_mean: float
    human_return_mean: float
    success_rate: float
    actor_loss: float
    critic_loss: float
    entropy_coefficient: float


@dataclass(frozen=True)
class PolicyRecord:
    """A policy that is on disk (PolicyInfo.msg)."""

    policy_id: str
    uri: str
    """Relative to the run folder."""
    steps: int
    """World steps of training."""
    success_rate: float
    """Of its last evaluation; NaN before the first."""


def check_finite(name: str, values: NDArray[np.floating]) -> None:
    """Raise ShapeError if ``values`` is empty or has NaN or infinite elements."""
    if values.size == 0:
        raise ShapeError(f"{name} is empty")
    if not np.isfinite(values).all():
        bad = np.flatnonzero(~np.isfinite(values))
        raise ShapeError(
            f"{name} has {bad.size} NaN or infinite of {values.size} values, first at {bad[0]}"
        )
