"""Optimal transport between videos: costs, solvers, distance and reward."""

from rapl_core.transport.config import TransportConfig, TransportResult
from rapl_core.transport.costs import pairwise_cost
from rapl_core.transport.distance import ot_distance
from rapl_core.transport.reward import ot_reward
from rapl_core.transport.solvers import marginal_error, solve

__all__ = [
    "TransportConfig",
    "TransportResult",
    "marginal_error",
    "ot_distance",
    "ot_reward",
    "pairwise_cost",
    "solve",
]
