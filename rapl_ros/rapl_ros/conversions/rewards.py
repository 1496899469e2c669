"""Rewards."""

import numpy as np
from rapl_msgs import msg as wire_msg

from rapl_core.errors import ShapeError
from rapl_core.types import (
    RewardTrace,
)
from rapl_ros.conversions.headers import floats_to_ros, header_to_ros, key_from_ros
from rapl_ros.wire import (
    EpisodeReward,
)


def reward_to_ros(whose: EpisodeReward, trace: RewardTrace) -> wire_msg.Reward:
    """A valid reward."""
    msg = invalid_reward_to_ros(whose, "")
    msg.valid = True
    msg.total = float(trace.total)
    msg.expert_id = trace.expert_id
    msg.transport_cost = float(trace.transport_cost)
    msg.converged = bool(trace.converged)
    msg.iterations = int(trace.iterations)
    msg.marginal_error = float(trace.marginal_error)
    msg.scale = float(trace.scale)
    msg.values = floats_to_ros(trace.values)
    return msg


def invalid_reward_to_ros(whose: EpisodeReward, reason: str) -> wire_msg.Reward:
    """The message of an episode that was dropped, and why."""
    return wire_msg.Reward(
        header=header_to_ros(whose.key),
        episode_id=whose.episode_id,
        world=int(whose.world),
        purpose=whose.purpose,
        valid=False,
        reason=reason,
        encoder=whose.encoder,
        version=whose.version,
    )


def reward_from_ros(msg: wire_msg.Reward) -> tuple[EpisodeReward, RewardTrace | None]:
    """Whose reward it is, and the reward; None when the episode was dropped (see ``msg.reason``).

    :raises ShapeError: if a valid reward has no values or any that is not finite.
    """
    whose = EpisodeReward(
        key=key_from_ros(msg.header),
        episode_id=msg.episode_id,
        world=msg.world,
        purpose=msg.purpose,
        encoder=msg.encoder,
        version=msg.version,
    )
    if not msg.valid:
        return whose, None
    values = np.array(msg.values, dtype=np.float64)
    if values.size == 0 or not np.isfinite(values).all():
        raise ShapeError(f"reward of episode {msg.episode_id} is empty or not finite")
    trace = RewardTrace(
        values=values,
        expert_id=msg.expert_id,
        transport_cost=msg.transport_cost,
        converged=msg.converged,
        iterations=msg.iterations,
        marginal_error=msg.marginal_error,
        scale=msg.scale,
    )
    return whose, trace
