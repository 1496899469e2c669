"""The reward of a robot's video: how cheaply it is transported to a preferred one.

Needs no torch: the node that computes it from a stream has 65 MiB instead of 300.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.transport.config import CostKind, TransportConfig
from rapl_core.transport.couplings import Matrix, couple
from rapl_core.types import EmbeddedEpisode, RewardTrace

_ZERO_NORM = 1e-12


def ot_reward(
    z: NDArray[Any], experts: Sequence[EmbeddedEpisode], config: TransportConfig, scale: float
) -> RewardTrace:
    """Reward of each frame of a video (eq. ot_reward), in float64:

        values[t] = -scale * T * sum_s c(z_t, e_s) mu*(t, s)

    The factor T undoes the mass 1/T of a frame, so that values do not depend on the length of the
    video. ``config.expert`` = ``closest`` takes the expert of least transport cost
    (eq. select_expert_obs); ``mean`` averages over all experts, weighted by their length, and its
    ``expert_id`` is empty. The trace's ``converged`` is false if the solver failed for any expert,
    since then the choice is in doubt too; its iterations and error are the largest of all.

    :param z: (T, D) embeddings of frames 1..T.
    :param experts: the preferred videos D+ through the same encoder.
    :param scale: stored with the encoder.
    :raises ShapeError: if embeddings are not finite matrices of one width or there is no expert.
    :raises ConvergenceError: if ``config.require_convergence`` and the solver did not converge.
    """
    x = _checked(z, experts, scale)
    couplings = couple(
        [frame_cost(x, expert.values.astype(np.float64), config.cost) for expert in experts],
        config,
    )
    per_frame = np.stack([coupling.per_frame for coupling in couplings])  # (E, T)
    distances = np.array([coupling.total for coupling in couplings])  # (E,)
    if config.expert == "closest":
        closest = int(distances.argmin())
        expert_id, cost = experts[closest].episode_id, float(distances[closest])
        chosen = per_frame[closest]
    else:
        weights = np.array([len(expert.values) for expert in experts], dtype=np.float64)
        weights /= weights.sum()
        expert_id, cost, chosen = "", float(weights @ distances), weights @ per_frame
    return RewardTrace(
        values=-scale * len(x) * chosen,
        expert_id=expert_id,
        transport_cost=cost,
        converged=all(coupling.converged for coupling in couplings),
        iterations=max(coupling.iterations for coupling in couplings),
        marginal_error=max(coupling.marginal_error for coupling in couplings),
        scale=float(scale),
    )


def frame_cost(x: Matrix, y: Matrix, kind: CostKind) -> Matrix:
    """Cost between every frame of ``x`` (T, D) and every frame of ``y`` (S, D); (T, S).

    Equals :func:`costs.pairwise_cost`, which is differentiable.
    """
    if kind == "cosine":
        return np.asarray(1.0 - _unit(x) @ _unit(y).T)
    squares = np.square(x[:, None, :] - y[None, :, :]).sum(-1)  # (T, S)
    return np.asarray(np.sqrt(squares) if kind == "euclidean" else squares)


def _unit(x: Matrix) -> Matrix:
    norm = np.linalg.norm(x, axis=-1, keepdims=True)
    return np.where(norm < _ZERO_NORM, 0.0, x / np.where(norm < _ZERO_NORM, 1.0, norm))


def _checked(z: NDArray[Any], experts: Sequence[EmbeddedEpisode], scale: float) -> Matrix:
    z = np.asarray(z)
    if z.ndim != 2 or 0 in z.shape:
        raise ShapeError(f"embedding has shape {z.shape}, expected (T, D), not empty")
    if not np.all(np.isfinite(z)):
        raise ShapeError(f"embedding has {int((~np.isfinite(z)).sum())} NaN or infinite values")
    if not experts:
        raise ShapeError("no expert video, expected at least one")
    if not (math.isfinite(scale) and scale > 0):
        raise ShapeError(f"reward scale is {scale}, expected a number above 0")
    for expert in experts:
        if len(expert.values) == 0 or expert.values.shape[1] != z.shape[1]:
            raise ShapeError(
                f"expert {expert.episode_id} has embeddings of shape {expert.values.shape}, "
                f"expected (S, {z.shape[1]}), not empty"
            )
    return z.astype(np.float64)
