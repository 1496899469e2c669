"""What crosses module boundaries: frozen, validated on creation, shape under each field."""

import re
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError, ShapeError, UnknownNameError

EPISODE_ID = re.compile(r"[a-z0-9_-]{1,64}")

Purpose = Literal["train", "evaluate", "demonstrate"]
Noise = Literal["plain", "smoothing", "estimated"]
"""What is made of the probability that an answer is wrong."""
Verdict = Literal["ranked", "undecided", "skipped", "withdrawn"]


def check_episode_id(episode_id: str) -> str:
    """Return ``episode_id`` if it is well formed.

    :raises ShapeError: if it has other characters than ``[a-z0-9_-]`` or more than 64.
    """
    if not EPISODE_ID.fullmatch(episode_id):
        raise ShapeError(f"episode id {episode_id!r} is not 1 to 64 characters of [a-z0-9_-]")
    return episode_id


def check_shape(name: str, array: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    """Raise ShapeError unless ``array`` has ``shape`` (None: any size)."""
    if len(array.shape) != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        want_text = "(" + ", ".join("*" if s is None else str(s) for s in shape) + ")"
        raise ShapeError(f"{name} has shape {array.shape}, expected {want_text}")


@dataclass(frozen=True)
class Episode:
    """One complete episode: T transitions between T + 1 instants."""

    episode_id: str
    task: str
    world: int
    purpose: str
    controller: str
    frames: NDArray[np.uint8]
    """(T + 1, H, W, 3) RGB."""
    states: NDArray[np.float64]
    """(T + 1, S) privileged states; names and units are the task's."""
    actions: NDArray[np.float64]
    """(T, A), each in [-1, 1]."""
    stamps_ns: NDArray[np.int64]
    """(T + 1,) strictly increasing."""
    human_rewards: NDArray[np.float64] | None = None
    """(T + 1,) r* of the state at each instant; None where the truth is unknown."""
    success: bool | None = None
    behaviour: str = ""
    """What produced it, e.g. a demonstrator's behaviour or a policy id."""

    def __post_init__(self) -> None:
        check_episode_id(self.episode_id)
        instants = len(self.frames)
        check_shape("frames", self.frames, (instants, None, None, 3))
        if self.frames.dtype != np.uint8:
            raise ShapeError(f"frames have dtype {self.frames.dtype}, expected uint8")
        check_shape("states", self.states, (instants, None))
        check_shape("actions", self.actions, (instants - 1, None))
        check_shape("stamps_ns", self.stamps_ns, (instants,))
        if not np.all(np.diff(self.stamps_ns) > 0):
            raise ShapeError(f"stamps of episode {self.episode_id} do not increase strictly")
        if self.human_rewards is not None:
            check_shape("human_rewards", self.human_rewards, (instants,))

    @property
    def steps(self) -> int:
        """T, the number of transitions."""
        return len(self.frames) - 1

    @property
    def human_return(self) -> float:
        """Sum of r* over the T states arrived in; NaN where unknown."""
        return float("nan") if self.human_rewards is None else float(self.human_rewards[1:].sum())


@dataclass(frozen=True)
class Ranking:
    """A person's answer about two or more videos."""

    ranking_id: str
    annotator: str
    episode_ids: tuple[str, ...]
    """As shown, left to right."""
    ranks: tuple[int, ...]
    """1 = best, equal numbers tie; empty unless ranked."""
    verdict: Verdict = "ranked"
    query_id: str = ""
    response_s: float = float("nan")
    created_ns: int = 0
    """Wall clock."""
    replaces: str = ""
    """The ranking_id that this one corrects or, withdrawn, takes back."""
    shown_ns: int = 0
    """Wall clock at which the videos began to play; 0: unknown."""
    source: str = ""
    """What showed them, e.g. ``web``."""

    def __post_init__(self) -> None:
        if not self.ranking_id or len(self.ranking_id) > 64:
            raise RankingError(f"ranking_id {self.ranking_id!r} is not 1 to 64 characters")
        if self.verdict not in get_args(Verdict):
            raise UnknownNameError("verdict", str(self.verdict), get_args(Verdict))
        if self.verdict == "withdrawn" and not self.replaces:
            raise RankingError(
                f"ranking {self.ranking_id} is withdrawn and names none to take back"
            )
        for name in ("annotator", "query_id", "replaces", "source"):
            if len(getattr(self, name)) > 64:
                raise RankingError(f"ranking {self.ranking_id}: {name} has more than 64 characters")
        for episode_id in self.episode_ids:
            check_episode_id(episode_id)
        if len(self.episode_ids) < 2:
            raise RankingError(f"a ranking needs two or more videos, got {len(self.episode_ids)}")
        repeated = {e for e in self.episode_ids if self.episode_ids.count(e) > 1}
        if repeated:
            raise RankingError(f"ranking {self.ranking_id} repeats {', '.join(sorted(repeated))}")
        expected = len(self.episode_ids) if self.verdict == "ranked" else 0
        if len(self.ranks) != expected:
            raise RankingError(
                f"ranking {self.ranking_id} is {self.verdict} and has {len(self.ranks)} ranks, "
                f"expected {expected}"
            )
        if self.ranks and (min(self.ranks) != 1 or max(self.ranks) > len(self.ranks)):
            raise RankingError(f"ranks {self.ranks} are not within 1..{len(self.ranks)}, 1 = best")


@dataclass(frozen=True)
class Triplet:
    """Three videos in strict order of preference (paper, Definition 1)."""

    best: str
    middle: str
    worst: str


@dataclass(frozen=True)
class DoubtedTriplet(Triplet):
    """A triplet and how far its annotator is to be trusted."""

    mistakes: float = 0.0
    """Probability that one comparison of it was answered wrong, in [0, 0.5]."""

    def __post_init__(self) -> None:
        if not 0 <= self.mistakes <= 0.5:
            raise RankingError(f"mistakes is {self.mistakes}, expected 0 to 0.5")


@dataclass(frozen=True)
class EncoderInfo:
    """What an encoder is."""

    name: str
    version: str
    """First 16 hex digits of the SHA-256 of weights and preprocessing."""
    backbone: str
    preset: str
    dimension: int
    image_width: int
    image_height: int
    reward_scale: float


@dataclass(frozen=True)
class EmbeddedEpisode:
    """A video through one encoder."""

    episode_id: str
    values: NDArray[np.float32]
    """(T, D), frames 1..T: the frame arrived in by each transition."""

    def __post_init__(self) -> None:
        check_episode_id(self.episode_id)
        check_shape("values", self.values, (None, None))
        if not np.all(np.isfinite(self.values)):
            raise ShapeError(f"embedding of episode {self.episode_id} has NaN or infinite values")


@dataclass(frozen=True)
class ExpertSet:
    """The preferred videos D+ through one encoder."""

    encoder: str
    version: str
    experts: tuple[EmbeddedEpisode, ...]


@dataclass(frozen=True)
class RewardTrace:
    """The reward of one episode and how it was found."""

    values: NDArray[np.float64]
    """(T,) values[t] belongs to the transition t -> t + 1 and comes from frame t + 1."""
    expert_id: str
    """Closest expert; empty when the reward is not matched to a single one."""
    transport_cost: float
    """Before scaling."""
    converged: bool
    iterations: int
    marginal_error: float
    scale: float

    @property
    def total(self) -> float:
        """Sum of values."""
        return float(self.values.sum())
