"""Rewards that no transport makes: a known number a frame, the way to a goal, a clock.

Free of torch, for the node that computes rewards from a stream.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.types import EmbeddedEpisode, RewardTrace

RewardKind = Literal["ot", "scalar", "goal", "clock"]
"""``ot``: optimal transport to the experts. ``scalar``: the first value of an embedding is the
reward itself (a reward network such as RLHF's). ``goal``: negative distance to the mean of the
experts' last frames (XIRL). ``clock``: the frame's index alone, a control."""

KINDS_WITH_EXPERTS = frozenset({"ot", "goal"})


def plain_reward(rewards: NDArray[Any], scale: float) -> RewardTrace:
    """``scale`` times what is known of each step.

    :param rewards: (T,) unscaled.
    :raises ShapeError: if one is not finite.
    """
    values = scale * np.asarray(rewards, dtype=np.float64)
    if not np.all(np.isfinite(values)):
        raise ShapeError(f"reward has {int((~np.isfinite(values)).sum())} NaN or infinite values")
    return RewardTrace(
        values=values,
        expert_id="",
        transport_cost=0.0,
        converged=True,
        iterations=0,
        marginal_error=0.0,
        scale=float(scale),
    )


def goal_embedding(experts: Sequence[EmbeddedEpisode], dimension: int) -> NDArray[np.float64]:
    """The mean (D,) of the experts' last frames.

    :raises ShapeError: without experts, or for one that is empty or of another width.
    """
    if not experts:
        raise ShapeError("no expert video, expected at least one")
    for expert in experts:
        if len(expert.values) == 0 or expert.values.shape[1] != dimension:
            raise ShapeError(
                f"expert {expert.episode_id} has embeddings of shape {expert.values.shape}, "
                f"expected (S, {dimension}), not empty"
            )
    return np.asarray(
        np.mean([np.asarray(e.values[-1], dtype=np.float64) for e in experts], axis=0)
    )


def goal_reward(z: NDArray[Any], experts: Sequence[EmbeddedEpisode], scale: float) -> RewardTrace:
    """Minus the distance to the mean goal embedding (Zakka et al. 2022, XIRL, section 3.2):

        values[t] = -scale * || z_t - mean_i e_i[-1] ||

    :param z: (T, D) embeddings of frames 1..T.
    :param experts: the demonstrations through the same encoder; only their last frame counts.
    :raises ShapeError: if embeddings are not finite matrices of one width or there is no expert.
    """
    x = _checked(z)
    return plain_reward(-np.linalg.norm(x - goal_embedding(experts, x.shape[1]), axis=1), scale)


def clock_reward(z: NDArray[Any], scale: float) -> RewardTrace:
    """A reward that sees nothing: it rises evenly from -1 to 0 over the video, times ``scale``."""
    length = len(_checked(z))
    return plain_reward(np.arange(1 - length, 1) / length, scale)


def scalar_reward(z: NDArray[Any], scale: float) -> RewardTrace:
    """The first value of each embedding, times ``scale``."""
    return plain_reward(_checked(z)[:, 0], scale)


def _checked(z: NDArray[Any]) -> NDArray[np.float64]:
    z = np.asarray(z)
    if z.ndim != 2 or 0 in z.shape:
        raise ShapeError(f"embedding has shape {z.shape}, expected (T, D), not empty")
    if not np.all(np.isfinite(z)):
        raise ShapeError(f"embedding has {int((~np.isfinite(z)).sum())} NaN or infinite values")
    return z.astype(np.float64)
