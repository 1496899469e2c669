"""Optimal couplings between two videos with uniform mass on their frames."""

import numpy as np
import ot
import torch

from rapl_core.errors import ConvergenceError, ShapeError
from rapl_core.transport.config import TransportConfig, TransportResult

_LINEAR_ITERATIONS = 9
_EXACT_ITERATIONS = 1_000_000
_EXACT_TOLERANCE = 1e-9


def solve(cost: torch.Tensor, config: TransportConfig) -> TransportResult:
    """Solve the transport problem of each cost matrix; no gradient flows through the plan.

    Everything is computed in float64 and returned in the dtype of ``cost``. Each problem of a batch
    stops by itself, so a batch gives what its members give one by one.

    :param cost: (..., T, S) finite costs.
    :raises ShapeError: if it is not a stack of matrices or has NaN or infinite values.
    :raises ConvergenceError: if ``config.require_convergence`` and one did not converge.
    """
    if cost.ndim < 2 or 0 in cost.shape:
        raise ShapeError(f"cost has shape {tuple(cost.shape)}, expected (..., T, S), none empty")
    if not bool(torch.isfinite(cost).all()):
        raise ShapeError("cost has NaN or infinite values")
    batch = cost.shape[:-2]
    costs = cost.detach().to(torch.float64).reshape(-1, *cost.shape[-2:])  # (B, T, S)
    if config.solver == "sinkhorn":
        plan, iterations = _sinkhorn(costs, config)
        tolerance = config.tolerance
    elif config.solver == "exact":
        plan, iterations = _exact(costs)
        tolerance = _EXACT_TOLERANCE
    else:
        plan = torch.full_like(costs, 1.0 / (costs.shape[-1] * costs.shape[-2]))
        iterations = torch.zeros(len(costs), dtype=torch.int64)
        tolerance = _EXACT_TOLERANCE
    error = marginal_error(plan)  # (B,)
    converged = error <= tolerance
    if config.require_convergence and not bool(converged.all()):
        raise ConvergenceError(
            f"{config.solver} left {int((~converged).sum())} of {len(costs)} problems with a "
            f"marginal error of {float(error.max()):.2e} after {int(iterations.max())} iterations, "
            f"expected at most {tolerance:.0e}; raise epsilon ({config.epsilon}) or "
            f"max_iterations ({config.max_iterations}), or use the solver 'exact'"
        )
    return TransportResult(
        plan=plan.to(cost.dtype).reshape(cost.shape),
        cost=(plan * costs).sum((-1, -2)).to(cost.dtype).reshape(batch),
        converged=converged.reshape(batch),
        iterations=iterations.reshape(batch),
        marginal_error=error.reshape(batch),
    )


def marginal_error(plan: torch.Tensor) -> torch.Tensor:
    """L1 distance of a plan's marginals from the uniform ones, (..., T, S) -> (...)."""
    rows = (plan.sum(-1) - 1.0 / plan.shape[-2]).abs().sum(-1)
    columns = (plan.sum(-2) - 1.0 / plan.shape[-1]).abs().sum(-1)
    return rows + columns


def _sinkhorn(costs: torch.Tensor, config: TransportConfig) -> tuple[torch.Tensor, torch.Tensor]:
    """Sinkhorn in the log domain; plans (B, T, S) and iterations (B,).

    With potentials f, g in units of epsilon the plan is exp(f + g - C / epsilon). One iteration in
    the log domain is followed by nine on the plan itself (the kernel with its potentials absorbed:
    Schmitzer 2019, arXiv:1610.06519, section 3.2), which are the same iterations at the price of a
    matrix-vector product. Where these under- or overflow the log-domain iterate stands.
    """
    scaled = costs / config.epsilon
    batch, t, s = costs.shape
    log_a, log_b = -float(np.log(t)), -float(np.log(s))
    f, g = scaled.new_zeros(batch, t), scaled.new_zeros(batch, s)
    plan = torch.full_like(costs, 1.0 / (t * s))
    iterations = torch.zeros(batch, dtype=torch.int64)
    active = torch.arange(batch)
    while len(active):
        c = scaled[active]
        f_new = log_a - torch.logsumexp(g[active][:, None, :] - c, dim=-1)
        g_new = log_b - torch.logsumexp(f_new[:, :, None] - c, dim=-2)
        f_new, g_new = _accelerate(f_new, g_new, c)
        f[active], g[active] = f_new, g_new
        plan[active] = torch.exp(f_new[:, :, None] + g_new[:, None, :] - c)
        iterations[active] += 1 + _LINEAR_ITERATIONS
        unsolved = marginal_error(plan[active]) > config.tolerance
        active = active[unsolved & (iterations[active] < config.max_iterations)]
    return plan, iterations


def _accelerate(
    f: torch.Tensor, g: torch.Tensor, c: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Nine Sinkhorn iterations on exp(f + g - c); potentials (B, T) and (B, S)."""
    kernel = torch.exp(f[:, :, None] + g[:, None, :] - c)  # (B, T, S)
    v = torch.ones_like(g)
    u = torch.ones_like(f)
    for _ in range(_LINEAR_ITERATIONS):
        u = (1.0 / f.shape[-1]) / torch.einsum("bts,bs->bt", kernel, v)
        v = (1.0 / g.shape[-1]) / torch.einsum("bts,bt->bs", kernel, u)
    f_new, g_new = f + u.log(), g + v.log()
    sound = torch.isfinite(f_new).all(-1) & torch.isfinite(g_new).all(-1)  # (B,)
    return torch.where(sound[:, None], f_new, f), torch.where(sound[:, None], g_new, g)


def _exact(costs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Network simplex of POT, one problem after another; plans (B, T, S), iterations 0."""
    a = np.full(costs.shape[-2], 1.0 / costs.shape[-2])
    b = np.full(costs.shape[-1], 1.0 / costs.shape[-1])
    plans = [ot.emd(a, b, c, numItermax=_EXACT_ITERATIONS) for c in costs.cpu().numpy()]
    return torch.from_numpy(np.stack(plans)), torch.zeros(len(costs), dtype=torch.int64)
