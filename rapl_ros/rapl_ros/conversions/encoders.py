"""Encoders, embeddings, experts."""

from typing import cast

import numpy as np
from rapl_msgs import msg as wire_msg
from std_msgs.msg import Header

from rapl_core.errors import ShapeError
from rapl_core.streaming.reward_rule import RewardKind, RewardRule
from rapl_core.transport.config import CostKind, ExpertChoice, SolverKind, TransportConfig
from rapl_core.types import (
    EmbeddedEpisode,
    EncoderInfo,
    ExpertSet,
)
from rapl_ros.conversions.headers import header_to_ros, key_from_ros, singles_to_ros, time_to_ros
from rapl_ros.wire import (
    EmbeddedFrame,
    JoinKey,
)


def encoder_info_to_ros(info: EncoderInfo, rule: RewardRule, stamp_ns: int) -> wire_msg.EncoderInfo:
    """EncoderInfo and how a reward follows from its embeddings; stamped when it took over."""
    return wire_msg.EncoderInfo(
        header=Header(stamp=time_to_ros(stamp_ns)),
        encoder=info.name,
        version=info.version,
        backbone=info.backbone,
        preset=info.preset,
        dimension=int(info.dimension),
        image_width=int(info.image_width),
        image_height=int(info.image_height),
        reward_scale=float(rule.scale),
        reward_kind=rule.kind,
        cost=rule.transport.cost,
        solver=rule.transport.solver,
        epsilon=float(rule.transport.epsilon),
        max_iterations=int(rule.transport.max_iterations),
        tolerance=float(rule.transport.tolerance),
        expert=rule.transport.expert,
    )


def reward_rule_from_ros(msg: wire_msg.EncoderInfo) -> RewardRule:
    """How a reward follows from the embeddings of this encoder.

    :raises RaplError: if cost, solver, expert choice or kind is unknown or a number out of range.
    """
    if msg.reward_kind == "scalar":
        return RewardRule("scalar", msg.reward_scale)
    transport = TransportConfig(
        cost=cast(CostKind, msg.cost),
        solver=cast(SolverKind, msg.solver),
        epsilon=msg.epsilon,
        max_iterations=msg.max_iterations,
        tolerance=msg.tolerance,
        expert=cast(ExpertChoice, msg.expert),
    )
    return RewardRule(cast(RewardKind, msg.reward_kind), msg.reward_scale, transport)


def encoder_info_from_ros(msg: wire_msg.EncoderInfo) -> EncoderInfo:
    """EncoderInfo to rapl_core's."""
    return EncoderInfo(
        name=msg.encoder,
        version=msg.version,
        backbone=msg.backbone,
        preset=msg.preset,
        dimension=msg.dimension,
        image_width=msg.image_width,
        image_height=msg.image_height,
        reward_scale=msg.reward_scale,
    )


def embedding_to_ros(frame: EmbeddedFrame) -> wire_msg.Embedding:
    """EmbeddedFrame to Embedding."""
    return wire_msg.Embedding(
        header=header_to_ros(frame.image),
        encoder=frame.encoder,
        version=frame.version,
        values=singles_to_ros(frame.values),
    )


def failed_embedding_to_ros(image: JoinKey, encoder: str, version: str) -> wire_msg.Embedding:
    """An Embedding without values: this image could not be embedded and never will be."""
    return wire_msg.Embedding(header=header_to_ros(image), encoder=encoder, version=version)


def embedding_from_ros(msg: wire_msg.Embedding) -> EmbeddedFrame:
    """Embedding to EmbeddedFrame.

    :raises ShapeError: if the values are empty or not finite.
    """
    return EmbeddedFrame(
        image=key_from_ros(msg.header),
        encoder=msg.encoder,
        version=msg.version,
        values=np.array(msg.values, dtype=np.float32),
    )


def experts_to_ros(experts: ExpertSet, stamp_ns: int) -> wire_msg.ExpertSet:
    """ExpertSet to its message."""
    return wire_msg.ExpertSet(
        header=Header(stamp=time_to_ros(stamp_ns)),
        encoder=experts.encoder,
        version=experts.version,
        experts=[embedded_episode_to_ros(expert) for expert in experts.experts],
    )


def experts_from_ros(msg: wire_msg.ExpertSet) -> ExpertSet:
    """ExpertSet message to rapl_core's.

    :raises ShapeError: if an expert's values are not frames x dimension, or not finite.
    """
    experts = tuple(embedded_episode_from_ros(expert) for expert in msg.experts)
    return ExpertSet(msg.encoder, msg.version, experts)


def embedded_episode_to_ros(episode: EmbeddedEpisode) -> wire_msg.EmbeddedEpisode:
    """EmbeddedEpisode to its message."""
    return wire_msg.EmbeddedEpisode(
        episode_id=episode.episode_id,
        frames=int(episode.values.shape[0]),
        dimension=int(episode.values.shape[1]),
        values=singles_to_ros(episode.values),
    )


def embedded_episode_from_ros(msg: wire_msg.EmbeddedEpisode) -> EmbeddedEpisode:
    """EmbeddedEpisode message to rapl_core's.

    :raises ShapeError: if its values are not frames x dimension, or not finite.
    """
    expected = msg.frames * msg.dimension
    if len(msg.values) != expected or expected == 0:
        raise ShapeError(
            f"video {msg.episode_id} has {len(msg.values)} values, expected "
            f"frames * dimension = {msg.frames} * {msg.dimension}"
        )
    values = np.array(msg.values, np.float32).reshape(msg.frames, msg.dimension)
    return EmbeddedEpisode(msg.episode_id, values)
