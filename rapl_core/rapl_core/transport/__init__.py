"""Optimal transport between videos: costs, solvers, distance and reward.

Names are imported at first use: whoever only needs the config or the reward does not load torch,
which takes 250 MiB and seconds.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rapl_core.transport.config import TransportConfig, TransportResult
    from rapl_core.transport.costs import pairwise_cost
    from rapl_core.transport.distance import ot_distance
    from rapl_core.transport.reward import ot_reward
    from rapl_core.transport.solvers import solve

__all__ = [
    "TransportConfig",
    "TransportResult",
    "ot_distance",
    "ot_reward",
    "pairwise_cost",
    "solve",
]

_HOMES = {
    "TransportConfig": "config",
    "TransportResult": "config",
    "ot_distance": "distance",
    "ot_reward": "reward",
    "pairwise_cost": "costs",
    "solve": "solvers",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
