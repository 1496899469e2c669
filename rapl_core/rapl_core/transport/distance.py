"""The distance of two videos, with a gradient for learning representations."""

import torch

from rapl_core.transport.config import TransportConfig
from rapl_core.transport.costs import pairwise_cost
from rapl_core.transport.solvers import solve


def ot_distance(x: torch.Tensor, y: torch.Tensor, config: TransportConfig) -> torch.Tensor:
    """Transport cost d = sum_ts mu*(t,s) c(x_t, y_s) between videos.

    The gradient goes through the cost c while the plan mu* is held fixed. By the envelope theorem
    that is the gradient of what the solver minimises: for ``exact`` of d itself (where mu* is
    unique), for ``sinkhorn`` of d - epsilon H(mu*), for ``uniform`` of d itself. For ``sinkhorn``
    it is thus not the full derivative of d: the part through mu* is left out, as is common practice
    (a part that vanishes as epsilon goes to 0 or to infinity).

    :param x: (..., T, D) embeddings.
    :param y: (..., S, D) embeddings; leading dimensions broadcast against those of ``x``.
    :return: (...) distances.
    :raises ConvergenceError: if ``config.require_convergence`` and the solver did not converge.
    """
    cost = pairwise_cost(x, y, config.cost)  # (..., T, S)
    if config.solver == "uniform":
        return cost.mean((-1, -2))
    return (solve(cost, config).plan * cost).sum((-1, -2))
