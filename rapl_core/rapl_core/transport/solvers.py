"""Optimal couplings of stacks of tensors, for learning."""

from collections.abc import Sequence

import numpy as np
import torch

from rapl_core.errors import ShapeError
from rapl_core.transport.config import TransportConfig, TransportResult
from rapl_core.transport.couplings import couple


def solve(cost: torch.Tensor, config: TransportConfig) -> TransportResult:
    """Solve the transport problem of each cost matrix; no gradient flows through the plan.

    Everything is computed in float64 on the processor (problems of this size are solved faster one
    by one in numpy than as a batch in torch) and returned in the dtype of ``cost``.

    :param cost: (..., T, S) finite costs.
    :raises ShapeError: if it is not a stack of matrices or has NaN or infinite values.
    :raises ConvergenceError: if ``config.require_convergence`` and one did not converge.
    """
    if cost.ndim < 2 or 0 in cost.shape:
        raise ShapeError(f"cost has shape {tuple(cost.shape)}, expected (..., T, S), none empty")
    if not bool(torch.isfinite(cost).all()):
        raise ShapeError("cost has NaN or infinite values")
    batch = cost.shape[:-2]
    costs = cost.detach().to("cpu", torch.float64).reshape(-1, *cost.shape[-2:])  # (B, T, S)
    couplings = couple(list(costs.numpy()), config)

    def stack(values: Sequence[object], dtype: torch.dtype) -> torch.Tensor:
        stacked = torch.from_numpy(np.asarray(values))  # (B,) or (B, T, S)
        return stacked.to(cost.device, dtype).reshape((*batch, *stacked.shape[1:]))

    return TransportResult(
        plan=stack([c.plan for c in couplings], cost.dtype),
        cost=stack([c.total for c in couplings], cost.dtype),
        converged=stack([c.converged for c in couplings], torch.bool),
        iterations=stack([c.iterations for c in couplings], torch.int64),
        marginal_error=stack([c.marginal_error for c in couplings], torch.float64),
    )
