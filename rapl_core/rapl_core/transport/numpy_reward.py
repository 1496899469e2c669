"""The optimal-transport reward without torch, for the node that computes it from a stream.

The same equations as ``reward.ot_reward``, step by step; a test holds the two together.
"""

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ConvergenceError, ShapeError
from rapl_core.transport.config import CostKind, TransportConfig
from rapl_core.types import EmbeddedEpisode, RewardTrace

Matrix = NDArray[np.float64]

_ZERO_NORM = 1e-12
_LINEAR_ITERATIONS = 9
_EXACT_ITERATIONS = 1_000_000
_EXACT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class _Solution:
    plan: Matrix
    """(T, S)"""
    cost: Matrix
    """(T, S) of a unit of mass."""
    iterations: int
    error: float
    converged: bool

    @property
    def total(self) -> float:
        return float((self.plan * self.cost).sum())

    @property
    def per_frame(self) -> Matrix:
        """(T,) cost share of each frame."""
        return np.asarray((self.plan * self.cost).sum(-1))


def ot_reward(
    z: NDArray[Any], experts: Sequence[EmbeddedEpisode], config: TransportConfig, scale: float
) -> RewardTrace:
    """Reward of each frame of a video, as ``rapl_core.transport.ot_reward`` documents it.

    :param z: (T, D) embeddings of frames 1..T.
    :param experts: the preferred videos D+ through the same encoder.
    :param scale: stored with the encoder.
    :raises ShapeError: if embeddings are not finite matrices of one width or there is no expert.
    :raises ConvergenceError: if ``config.require_convergence`` and the solver did not converge.
    """
    x = _checked(z, experts, scale)
    solutions = [
        _solve(pairwise_cost(x, expert.values.astype(np.float64), config.cost), config)
        for expert in experts
    ]
    per_frame = np.stack([solution.per_frame for solution in solutions])  # (E, T)
    distances = np.array([solution.total for solution in solutions])  # (E,)
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
        converged=all(solution.converged for solution in solutions),
        iterations=max(solution.iterations for solution in solutions),
        marginal_error=max(solution.error for solution in solutions),
        scale=float(scale),
    )


def pairwise_cost(x: Matrix, y: Matrix, kind: CostKind) -> Matrix:
    """Cost between every frame of ``x`` (T, D) and every frame of ``y`` (S, D); (T, S)."""
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


def _solve(cost: Matrix, config: TransportConfig) -> _Solution:
    iterations, tolerance = 0, _EXACT_TOLERANCE
    if config.solver == "sinkhorn":
        tolerance = config.tolerance
        plan, iterations = _sinkhorn(cost, config)
    elif config.solver == "exact":
        plan = _exact(cost)
    else:
        plan = np.full_like(cost, 1.0 / cost.size)
    error = _marginal_error(plan)
    if config.require_convergence and error > tolerance:
        raise ConvergenceError(
            f"{config.solver} left a marginal error of {error:.2e} after {iterations} iterations, "
            f"expected at most {tolerance:.0e}; raise epsilon ({config.epsilon}) or "
            f"max_iterations ({config.max_iterations}), or use the solver 'exact'"
        )
    return _Solution(plan, cost, iterations, error, error <= tolerance)


def _marginal_error(plan: Matrix) -> float:
    rows = np.abs(plan.sum(1) - 1.0 / plan.shape[0]).sum()
    columns = np.abs(plan.sum(0) - 1.0 / plan.shape[1]).sum()
    return float(rows + columns)


def _exact(cost: Matrix) -> Matrix:
    if "torch" not in sys.modules:  # else POT brings it in: 250 MiB that are not needed here
        os.environ.setdefault("POT_BACKEND_DISABLE_PYTORCH", "1")
    import ot

    t, s = cost.shape
    plan = ot.emd(np.full(t, 1.0 / t), np.full(s, 1.0 / s), cost, numItermax=_EXACT_ITERATIONS)
    return np.asarray(plan, dtype=np.float64)


def _sinkhorn(cost: Matrix, config: TransportConfig) -> tuple[Matrix, int]:
    """Sinkhorn in the log domain with absorbed inner iterations, as ``solvers.solve`` explains."""
    c = cost / config.epsilon
    log_a, log_b = -math.log(c.shape[0]), -math.log(c.shape[1])
    g = np.zeros(c.shape[1])
    iterations = 0
    while True:
        f = log_a - _logsumexp(g[None, :] - c, 1)
        g = log_b - _logsumexp(f[:, None] - c, 0)
        f, g = _accelerate(f, g, c)
        plan = np.exp(f[:, None] + g[None, :] - c)
        iterations += 1 + _LINEAR_ITERATIONS
        if _marginal_error(plan) <= config.tolerance or iterations >= config.max_iterations:
            return plan, iterations


def _accelerate(f: Matrix, g: Matrix, c: Matrix) -> tuple[Matrix, Matrix]:
    kernel = np.exp(f[:, None] + g[None, :] - c)  # (T, S)
    u, v = np.ones_like(f), np.ones_like(g)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_LINEAR_ITERATIONS):
            u = (1.0 / len(f)) / (kernel @ v)
            v = (1.0 / len(g)) / (u @ kernel)
        f_new, g_new = f + np.log(u), g + np.log(v)
    if np.isfinite(f_new).all() and np.isfinite(g_new).all():
        return f_new, g_new
    return f, g


def _logsumexp(x: Matrix, axis: int) -> Matrix:
    top = x.max(axis=axis, keepdims=True)
    total = np.log(np.exp(x - top).sum(axis=axis)) + top.squeeze(axis)
    return np.asarray(total)
