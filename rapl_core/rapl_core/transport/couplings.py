"""Optimal couplings of two videos with uniform mass on their frames. Needs no torch."""

import math
import os
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ConvergenceError
from rapl_core.transport.config import TransportConfig

Matrix = NDArray[np.float64]

_LINEAR_ITERATIONS = 9
_EXACT_ITERATIONS = 1_000_000
_EXACT_TOLERANCE = 1e-9


class Coupling(NamedTuple):
    """A plan and how it was found."""

    plan: Matrix
    """(T, S) mass moved from frame t to frame s; rows sum to 1/T, columns to 1/S."""
    cost: Matrix
    """(T, S) of a unit of mass: the problem."""
    converged: bool
    iterations: int
    """Of Sinkhorn; 0 for the other solvers, which do not count."""
    marginal_error: float
    """L1 distance of the plan's marginals from the uniform ones."""

    @property
    def per_frame(self) -> Matrix:
        """(T,) cost share of each frame."""
        return np.asarray((self.plan * self.cost).sum(-1))

    @property
    def total(self) -> float:
        """Sum of plan times cost, without the entropy."""
        return float((self.plan * self.cost).sum())


def couple(costs: Sequence[Matrix], config: TransportConfig) -> list[Coupling]:
    """Solve one transport problem after another.

    :param costs: (T, S) finite, each of any size.
    :raises ConvergenceError: if ``config.require_convergence`` and one did not converge.
    """
    couplings = [_couple(np.asarray(cost, dtype=np.float64), config) for cost in costs]
    lost = [coupling for coupling in couplings if not coupling.converged]
    if config.require_convergence and lost:
        raise ConvergenceError(
            f"{config.solver} left {len(lost)} of {len(couplings)} problems with a marginal error "
            f"of {max(c.marginal_error for c in lost):.2e} after "
            f"{max(c.iterations for c in lost)} iterations, expected at most "
            f"{_tolerance(config):.0e}; raise epsilon ({config.epsilon}) or max_iterations "
            f"({config.max_iterations}), or use the solver 'exact'"
        )
    return couplings


def marginal_error(plan: Matrix) -> float:
    """L1 distance of a plan's marginals (T, S) from the uniform ones."""
    rows = np.abs(plan.sum(1) - 1.0 / plan.shape[0]).sum()
    columns = np.abs(plan.sum(0) - 1.0 / plan.shape[1]).sum()
    return float(rows + columns)


def _couple(cost: Matrix, config: TransportConfig) -> Coupling:
    iterations = 0
    if config.solver == "sinkhorn":
        plan, iterations = _sinkhorn(cost, config)
    elif config.solver == "exact":
        plan = _exact(cost)
    else:
        plan = np.full_like(cost, 1.0 / cost.size)
    error = marginal_error(plan)
    return Coupling(plan, cost, error <= _tolerance(config), iterations, error)


def _tolerance(config: TransportConfig) -> float:
    return config.tolerance if config.solver == "sinkhorn" else _EXACT_TOLERANCE


def _exact(cost: Matrix) -> Matrix:
    """Network simplex of POT."""
    if "torch" not in sys.modules:  # else POT brings it in: 250 MiB that are not needed here
        os.environ.setdefault("POT_BACKEND_DISABLE_PYTORCH", "1")
    import ot

    t, s = cost.shape
    plan = ot.emd(np.full(t, 1.0 / t), np.full(s, 1.0 / s), cost, numItermax=_EXACT_ITERATIONS)
    return np.asarray(plan, dtype=np.float64)


def _sinkhorn(cost: Matrix, config: TransportConfig) -> tuple[Matrix, int]:
    """Sinkhorn in the log domain; the plan (T, S) and the iterations.

    With potentials f, g in units of epsilon the plan is exp(f + g - C / epsilon). One iteration in
    the log domain is followed by nine on the plan itself (the kernel with its potentials absorbed:
    Schmitzer 2019, arXiv:1610.06519, section 3.2), which are the same iterations at the price of a
    matrix-vector product. Where these under- or overflow the log-domain iterate stands.
    """
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
        if marginal_error(plan) <= config.tolerance or iterations >= config.max_iterations:
            return plan, iterations


def _accelerate(f: Matrix, g: Matrix, c: Matrix) -> tuple[Matrix, Matrix]:
    """Nine Sinkhorn iterations on exp(f + g - c); potentials (T,) and (S,)."""
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
