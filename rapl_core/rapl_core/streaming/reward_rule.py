"""How a reward follows from embeddings: what an encoder says of itself beside its name."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from numpy.typing import NDArray

from rapl_core.errors import UnknownNameError
from rapl_core.transport.config import TransportConfig
from rapl_core.transport.plain_rewards import (
    KINDS_WITH_EXPERTS,
    RewardKind,
    clock_reward,
    goal_reward,
    plain_reward,
    scalar_reward,
)
from rapl_core.transport.reward import ot_reward
from rapl_core.types import EmbeddedEpisode, RewardTrace

__all__ = ["RewardKind", "RewardRule", "plain_reward"]


@dataclass(frozen=True)
class RewardRule:
    """Turns the embeddings of an episode into its reward."""

    kind: RewardKind = "ot"
    scale: float = 1.0
    transport: TransportConfig = field(default_factory=TransportConfig)
    """Of kind ``ot`` only."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(RewardKind):
            raise UnknownNameError("reward kind", self.kind, get_args(RewardKind))

    @property
    def needs_experts(self) -> bool:
        """True when embeddings alone do not make a reward."""
        return self.kind in KINDS_WITH_EXPERTS

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace:
        """Reward of each transition.

        :param z: (T, D) embeddings of the frames arrived in.
        :raises ShapeError: if embeddings are not finite or experts are missing or do not fit.
        """
        if self.kind == "ot":
            return ot_reward(z, experts, self.transport, self.scale)
        if self.kind == "goal":
            return goal_reward(z, experts, self.scale)
        return (clock_reward if self.kind == "clock" else scalar_reward)(z, self.scale)
