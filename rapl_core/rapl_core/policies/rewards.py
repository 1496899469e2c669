"""Rewards of whole episodes: what the learner is given, whatever it comes from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.types import EmbeddedEpisode, Episode

if TYPE_CHECKING:  # the learner node does without the backbones
    from rapl_core.representations.encoder import Encoder

MEAN_PER_STEP = -2.0
"""What a scale brings the mean reward of a step in the worse half of the videos to: SAC's
entropy term then neither drowns it nor vanishes beside it."""


@dataclass(frozen=True)
class RewardSource:
    """What rewards come from; a run that is resumed must go on with the same."""

    name: str
    version: str
    scale: float


class EpisodeReward(Protocol):
    """Gives the rewards of a complete episode."""

    @property
    def source(self) -> RewardSource:
        """Name, version and scale."""
        ...

    @property
    def needs_frames(self) -> bool:
        """Whether it looks at the pictures; if not, none need to be drawn."""
        ...

    def __call__(self, episode: Episode) -> NDArray[np.float64]:
        """Return (T,) values[t] belongs to the transition t -> t + 1."""
        ...


class GroundTruthReward:
    """The human's own reward r*, scaled by the rule of all rewards; the oracle in tables.

    :param scale: from :func:`fit_scale`; kept in checkpoints.
    """

    needs_frames = False

    def __init__(self, scale: float) -> None:
        self.source = RewardSource("ground_truth", "", scale)

    def __call__(self, episode: Episode) -> NDArray[np.float64]:
        """Return scale * r* of the states arrived in (T,).

        :raises ShapeError: if the episode has no truth.
        """
        if episode.human_rewards is None:
            raise ShapeError(f"episode {episode.episode_id} has no human rewards")
        return np.asarray(self.source.scale * episode.human_rewards[1:], dtype=np.float64)


class EncoderReward:
    """The reward of an encoder: pictures to embeddings to transport to the experts.

    :param experts: the preferred videos through the same encoder.
    """

    needs_frames = True

    def __init__(self, encoder: "Encoder", experts: Sequence[EmbeddedEpisode]) -> None:
        info = encoder.info
        self.source = RewardSource(info.name, info.version, info.reward_scale)
        self._encoder = encoder
        self._experts = tuple(experts)

    def __call__(self, episode: Episode) -> NDArray[np.float64]:
        """Return the encoder's reward of the frames arrived in (T,)."""
        embedded = self._encoder.embed(episode.frames[1:])  # (T, D)
        return self._encoder.reward(embedded, self._experts).values


def fit_scale(
    unscaled: Iterable[NDArray[np.float64]], mean_per_step: float = MEAN_PER_STEP
) -> float:
    """Return the scale with which the worse half of some videos earn ``mean_per_step``.

    The rule by which encoders get their scale, so that ``ground_truth`` is compared fairly.
    Worse is judged by the reward itself.

    :param unscaled: rewards (T,) of each video with scale 1.
    :raises ShapeError: if there are none, or the worse half's are not negative on average.
    """
    means = np.sort([float(np.mean(values)) for values in unscaled])
    worse = float(means[: max(1, len(means) // 2)].mean()) if len(means) else float("nan")
    if not worse < 0:
        raise ShapeError(
            f"the worse half of {len(means)} videos has a mean reward of {worse}, expected below 0"
        )
    return mean_per_step / worse
