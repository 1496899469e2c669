"""How a reward follows from embeddings: what an encoder says of itself beside its name."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.transport.config import TransportConfig
from rapl_core.transport.reward import ot_reward
from rapl_core.types import EmbeddedEpisode, RewardTrace

RewardKind = Literal["ot", "scalar"]


@dataclass(frozen=True)
class RewardRule:
    """Turns the embeddings of an episode into its reward."""

    kind: RewardKind = "ot"
    """``ot``: optimal transport to the experts. ``scalar``: the first value of an embedding is the
    reward itself (a reward network such as RLHF's)."""
    scale: float = 1.0
    transport: TransportConfig = field(default_factory=TransportConfig)

    def __post_init__(self) -> None:
        if self.kind not in get_args(RewardKind):
            raise UnknownNameError("reward kind", self.kind, get_args(RewardKind))

    @property
    def needs_experts(self) -> bool:
        """True when embeddings alone do not make a reward."""
        return self.kind == "ot"

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace:
        """Reward of each transition.

        :param z: (T, D) embeddings of the frames arrived in.
        :raises ShapeError: if embeddings are not finite or experts are missing or do not fit.
        """
        if self.kind == "ot":
            return ot_reward(z, experts, self.transport, self.scale)
        if z.ndim != 2 or 0 in z.shape:
            raise ShapeError(f"embedding has shape {z.shape}, expected (T, D), not empty")
        return plain_reward(z[:, 0], self.scale)


def plain_reward(rewards: NDArray[Any], scale: float) -> RewardTrace:
    """A reward that no transport made: ``scale`` times what is known of each step.

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
