"""The reward of a robot's video: how cheaply it is transported to a preferred one."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.transport.config import TransportConfig, TransportResult
from rapl_core.transport.costs import pairwise_cost
from rapl_core.transport.solvers import solve
from rapl_core.types import EmbeddedEpisode, RewardTrace


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
    results, costs = _solve_each(x, experts, config)
    per_frame = torch.stack(  # (E, T)
        [(r.plan * c).sum(-1) for r, c in zip(results, costs, strict=True)]
    )
    distances = torch.stack([r.cost for r in results])  # (E,)
    if config.expert == "closest":
        closest = int(distances.argmin())
        expert_id, cost, chosen = (
            experts[closest].episode_id,
            float(distances[closest]),
            per_frame[closest],
        )
    else:
        weights = torch.tensor([len(e.values) for e in experts], dtype=torch.float64)
        weights = weights / weights.sum()
        expert_id, cost, chosen = "", float(weights @ distances), weights @ per_frame
    return RewardTrace(
        values=(-scale * len(x) * chosen).numpy(),
        expert_id=expert_id,
        transport_cost=cost,
        converged=all(bool(r.converged) for r in results),
        iterations=max(int(r.iterations) for r in results),
        marginal_error=max(float(r.marginal_error) for r in results),
        scale=float(scale),
    )


def _checked(z: NDArray[Any], experts: Sequence[EmbeddedEpisode], scale: float) -> torch.Tensor:
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
    return torch.from_numpy(z.astype(np.float64))


def _solve_each(
    x: torch.Tensor, experts: Sequence[EmbeddedEpisode], config: TransportConfig
) -> tuple[list[TransportResult], list[torch.Tensor]]:
    """One result and cost matrix (T, S) per expert; experts of one length are solved together."""
    costs = [
        pairwise_cost(x, torch.from_numpy(e.values.astype(np.float64)), config.cost)
        for e in experts
    ]
    if len({len(e.values) for e in experts}) > 1:
        return [solve(cost, config) for cost in costs], costs
    batch = solve(torch.stack(costs), config)
    fields = (batch.plan, batch.cost, batch.converged, batch.iterations, batch.marginal_error)
    return [TransportResult(*members) for members in zip(*fields, strict=True)], costs
