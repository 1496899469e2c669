"""Every ``x_from_ros`` and ``x_to_ros``: pure functions between messages and rapl_core's types.

rclpy does not check field types by default, and a numpy scalar arrives as garbage: everything is
cast here. Sequences go out as ``array.array``, which is microseconds where a numpy array is tenths
of seconds. What comes in is validated and refused with a RaplError.
"""

import io
import math
from array import array
from collections.abc import Iterable, Sequence
from typing import cast

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError
from rapl_msgs import msg as wire_msg
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import Header

from rapl_core.errors import RankingError, ShapeError
from rapl_core.streaming.reward_rule import RewardKind, RewardRule
from rapl_core.transport.config import CostKind, ExpertChoice, SolverKind, TransportConfig
from rapl_core.types import (
    EmbeddedEpisode,
    EncoderInfo,
    ExpertSet,
    Ranking,
    RewardTrace,
    Verdict,
)
from rapl_ros.progress import StageProgress
from rapl_ros.wire import (
    Command,
    EmbeddedFrame,
    EpisodeRecord,
    EpisodeReward,
    Instant,
    JoinKey,
    World,
)

SECOND_NS = 1_000_000_000

# Channels a pixel, and their order as indices into the message's channels.
ENCODINGS: dict[str, tuple[int, tuple[int, int, int]]] = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}


# Time and headers


def time_to_ros(stamp_ns: int) -> Time:
    """Nanoseconds to a stamp."""
    sec, nanosec = divmod(int(stamp_ns), SECOND_NS)
    return Time(sec=sec, nanosec=nanosec)


def time_from_ros(stamp: Time) -> int:
    """A stamp to nanoseconds."""
    return stamp.sec * SECOND_NS + stamp.nanosec


def header_to_ros(key: JoinKey) -> Header:
    """Join key to the header that it names."""
    return Header(stamp=time_to_ros(key.stamp_ns), frame_id=key.frame_id)


def key_from_ros(header: Header) -> JoinKey:
    """Header to the key by which image, state and embedding are joined."""
    return JoinKey(header.frame_id, time_from_ros(header.stamp))


# Arrays


def floats_to_ros(values: ArrayLike) -> "array[float]":
    """Any real array, row-major, to float64[]."""
    sequence = array("d")
    sequence.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return sequence


def singles_to_ros(values: ArrayLike) -> "array[float]":
    """Any real array, row-major, to float32[]."""
    sequence = array("f")
    sequence.frombytes(np.ascontiguousarray(values, dtype=np.float32).tobytes())
    return sequence


def bytes_to_ros(values: NDArray[np.uint8]) -> "array[int]":
    """A uint8 array, row-major, to uint8[]."""
    sequence = array("B")
    sequence.frombytes(np.ascontiguousarray(values).tobytes())
    return sequence


# Images


def image_to_ros(frame: NDArray[np.uint8], key: JoinKey) -> Image:
    """``frame`` (H, W, 3) RGB to an rgb8 image."""
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
        raise ShapeError(f"frame is {frame.dtype} {frame.shape}, expected uint8 (H, W, 3)")
    height, width = int(frame.shape[0]), int(frame.shape[1])
    return Image(
        header=header_to_ros(key),
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=width * 3,
        data=bytes_to_ros(frame),
    )


def image_from_ros(msg: Image) -> NDArray[np.uint8]:
    """Image of a known 8-bit encoding to (H, W, 3) RGB; rows may be padded.

    :raises ShapeError: with width, height, step, encoding and bytes when they contradict.
    """
    facts = (
        f"image with width={msg.width} height={msg.height} step={msg.step} "
        f"encoding='{msg.encoding}' and {len(msg.data)} bytes"
    )
    if msg.encoding not in ENCODINGS:
        raise ShapeError(f"{facts}: unknown encoding; known: {', '.join(sorted(ENCODINGS))}")
    channels, order = ENCODINGS[msg.encoding]
    if msg.width == 0 or msg.height == 0:
        raise ShapeError(f"{facts}: has no pixels")
    if msg.step < msg.width * channels:
        raise ShapeError(f"{facts}: expected a step of at least {msg.width * channels}")
    if len(msg.data) != msg.height * msg.step:
        raise ShapeError(f"{facts}: expected height * step = {msg.height * msg.step} bytes")
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, msg.step)
    pixels = rows[:, : msg.width * channels].reshape(msg.height, msg.width, channels)
    if channels == 3 and order == (0, 1, 2):
        return pixels
    return np.ascontiguousarray(pixels[:, :, list(order)])  # (H, W, 3)


def compressed_image_from_ros(msg: CompressedImage) -> NDArray[np.uint8]:
    """JPEG or PNG image to (H, W, 3) RGB.

    :raises ShapeError: if the bytes are no complete JPEG or PNG.
    """
    facts = f"compressed image with format='{msg.format}' and {len(msg.data)} bytes"
    try:
        with PillowImage.open(io.BytesIO(bytes(msg.data)), formats=("JPEG", "PNG")) as picture:
            return np.array(picture.convert("RGB"), dtype=np.uint8)
    except UnidentifiedImageError as error:
        raise ShapeError(f"{facts}: neither jpeg nor png") from error
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        raise ShapeError(f"{facts}: cannot be decoded: {error}") from error


# State, action, joints, world


def state_to_ros(instant: Instant) -> wire_msg.State:
    """Instant to State; an unknown truth becomes ``has_truth: false``."""
    has_truth = instant.human_reward is not None
    return wire_msg.State(
        header=header_to_ros(instant.key),
        image=header_to_ros(instant.image),
        world=int(instant.world),
        episode_id=instant.episode_id,
        purpose=instant.purpose,
        controller=instant.controller,
        step=int(instant.step),
        is_last=bool(instant.is_last),
        terminated=bool(instant.terminated),
        values=floats_to_ros(instant.values),
        has_truth=has_truth,
        human_reward=float(instant.human_reward) if has_truth else 0.0,
        success=bool(instant.success) if has_truth else False,
    )


def state_from_ros(msg: wire_msg.State) -> Instant:
    """State to Instant.

    :raises ShapeError: if the values are empty or not finite, or the episode id is malformed.
    """
    return Instant(
        key=key_from_ros(msg.header),
        image=key_from_ros(msg.image),
        world=msg.world,
        episode_id=msg.episode_id,
        purpose=msg.purpose,
        controller=msg.controller,
        step=msg.step,
        is_last=msg.is_last,
        terminated=msg.terminated,
        values=np.array(msg.values, dtype=np.float64),
        human_reward=msg.human_reward if msg.has_truth else None,
        success=msg.success if msg.has_truth else None,
    )


def action_to_ros(command: Command) -> wire_msg.Action:
    """Command to Action."""
    return wire_msg.Action(
        header=header_to_ros(command.key),
        world=int(command.world),
        episode_id=command.episode_id,
        step=int(command.step),
        controller=command.controller,
        behaviour=command.behaviour,
        values=floats_to_ros(command.values),
    )


def action_from_ros(msg: wire_msg.Action) -> Command:
    """Action to Command.

    :raises ShapeError: if the values are empty or not finite, or the episode id is malformed.
    """
    return Command(
        key=key_from_ros(msg.header),
        world=msg.world,
        episode_id=msg.episode_id,
        step=msg.step,
        controller=msg.controller,
        behaviour=msg.behaviour,
        values=np.array(msg.values, dtype=np.float64),
    )


def answer(instant: Instant, values: ArrayLike, behaviour: str = "") -> Command:
    """The command that answers ``instant`` with ``values`` (A,)."""
    return Command(
        key=instant.key,
        world=instant.world,
        episode_id=instant.episode_id,
        step=instant.step,
        controller=instant.controller,
        values=np.asarray(values, dtype=np.float64),
        behaviour=behaviour,
    )


def joint_state_to_ros(
    key: JoinKey, names: Sequence[str], positions: ArrayLike, velocities: ArrayLike
) -> JointState:
    """Joint names, positions (rad or m) and velocities to JointState."""
    return JointState(
        header=header_to_ros(key),
        name=list(names),
        position=floats_to_ros(positions),
        velocity=floats_to_ros(velocities),
    )


def camera_info_to_ros(key: JoinKey, width: int, height: int, fovy_deg: float) -> CameraInfo:
    """Pinhole camera without distortion, from its vertical field of view.

    The focal length is H / 2 / tan(fovy / 2) pixels, the principal point the picture's middle.
    """
    focal = height / 2 / math.tan(math.radians(fovy_deg) / 2)
    x, y = width / 2, height / 2
    return CameraInfo(
        header=header_to_ros(key),
        width=int(width),
        height=int(height),
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=[focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def world_to_ros(world: World, stamp_ns: int) -> wire_msg.WorldInfo:
    """World to WorldInfo."""
    return wire_msg.WorldInfo(
        header=Header(stamp=time_to_ros(stamp_ns)),
        task=world.task,
        worlds=int(world.worlds),
        period_s=float(world.period_s),
        max_steps=int(world.max_steps),
        lockstep=bool(world.lockstep),
        state_names=list(world.state_names),
        state_units=list(world.state_units),
        action_names=list(world.action_names),
        camera_frames=list(world.camera_frames),
        seed=int(world.seed),
    )


def world_from_ros(msg: wire_msg.WorldInfo) -> World:
    """WorldInfo to World."""
    return World(
        task=msg.task,
        worlds=msg.worlds,
        period_s=msg.period_s,
        max_steps=msg.max_steps,
        lockstep=msg.lockstep,
        state_names=tuple(msg.state_names),
        state_units=tuple(msg.state_units),
        action_names=tuple(msg.action_names),
        camera_frames=tuple(msg.camera_frames),
        seed=msg.seed,
    )


# Encoder, embedding, experts, reward


def encoder_info_to_ros(
    info: EncoderInfo, rule: RewardRule, stamp_ns: int
) -> wire_msg.EncoderInfo:
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
        experts=[
            wire_msg.EmbeddedEpisode(
                episode_id=expert.episode_id,
                frames=int(expert.values.shape[0]),
                dimension=int(expert.values.shape[1]),
                values=singles_to_ros(expert.values),
            )
            for expert in experts.experts
        ],
    )


def experts_from_ros(msg: wire_msg.ExpertSet) -> ExpertSet:
    """ExpertSet message to rapl_core's.

    :raises ShapeError: if an expert's values are not frames x dimension, or not finite.
    """
    experts = []
    for expert in msg.experts:
        expected = expert.frames * expert.dimension
        if len(expert.values) != expected or expected == 0:
            raise ShapeError(
                f"expert {expert.episode_id} has {len(expert.values)} values, expected "
                f"frames * dimension = {expert.frames} * {expert.dimension}"
            )
        values = np.array(expert.values, np.float32).reshape(expert.frames, expert.dimension)
        experts.append(EmbeddedEpisode(expert.episode_id, values))
    return ExpertSet(msg.encoder, msg.version, tuple(experts))


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


# Episodes and rankings


def episode_record_to_ros(record: EpisodeRecord) -> wire_msg.EpisodeInfo:
    """EpisodeRecord to EpisodeInfo."""
    has_truth = record.human_return is not None
    return wire_msg.EpisodeInfo(
        header=header_to_ros(record.key),
        episode_id=record.episode_id,
        task=record.task,
        world=int(record.world),
        purpose=record.purpose,
        controller=record.controller,
        behaviour=record.behaviour,
        steps=int(record.steps),
        uri=record.uri,
        has_truth=has_truth,
        human_return=float(record.human_return) if has_truth else 0.0,
        success=bool(record.success) if has_truth else False,
    )


def episode_record_from_ros(msg: wire_msg.EpisodeInfo) -> EpisodeRecord:
    """EpisodeInfo to EpisodeRecord."""
    return EpisodeRecord(
        key=key_from_ros(msg.header),
        episode_id=msg.episode_id,
        task=msg.task,
        world=msg.world,
        purpose=msg.purpose,
        controller=msg.controller,
        behaviour=msg.behaviour,
        steps=msg.steps,
        uri=msg.uri,
        human_return=msg.human_return if msg.has_truth else None,
        success=msg.success if msg.has_truth else None,
    )


VERDICTS: dict[int, Verdict] = {
    wire_msg.Ranking.RANKED: "ranked",
    wire_msg.Ranking.UNDECIDED: "undecided",
    wire_msg.Ranking.SKIPPED: "skipped",
}


def ranking_to_ros(ranking: Ranking) -> wire_msg.Ranking:
    """Ranking to its message."""
    return wire_msg.Ranking(
        ranking_id=ranking.ranking_id,
        query_id=ranking.query_id,
        annotator=ranking.annotator,
        verdict={text: number for number, text in VERDICTS.items()}[ranking.verdict],
        episode_ids=list(ranking.episode_ids),
        ranks=_counts_to_ros(ranking.ranks),
        response_s=float(ranking.response_s),
        created=time_to_ros(ranking.created_ns),
        replaces=ranking.replaces,
    )


def ranking_from_ros(msg: wire_msg.Ranking) -> Ranking:
    """Message to Ranking.

    :raises RankingError: if it is not acceptable: unknown verdict, repeated episodes, wrong ranks.
    """
    if msg.verdict not in VERDICTS:
        known = ", ".join(f"{number} = {text}" for number, text in VERDICTS.items())
        raise RankingError(f"ranking {msg.ranking_id} has verdict {msg.verdict}; known: {known}")
    return Ranking(
        ranking_id=msg.ranking_id,
        annotator=msg.annotator,
        episode_ids=tuple(msg.episode_ids),
        ranks=tuple(int(rank) for rank in msg.ranks),
        verdict=VERDICTS[msg.verdict],
        query_id=msg.query_id,
        response_s=msg.response_s,
        created_ns=time_from_ros(msg.created),
        replaces=msg.replaces,
    )


def _counts_to_ros(values: Iterable[int]) -> "array[int]":
    return array("H", [int(value) for value in values])


def progress_to_ros(progress: StageProgress, stamp_ns: int) -> wire_msg.Progress:
    """How far a stage is, at wall time ``stamp_ns``."""
    return wire_msg.Progress(
        header=Header(stamp=time_to_ros(stamp_ns)),
        stage=progress.stage,
        stage_index=int(progress.index),
        stages=int(progress.stages),
        status=progress.status,
        done=int(progress.done),
        total=int(progress.total),
        unit=progress.unit,
        rate_hz=float(progress.rate_hz),
        remaining_s=float(progress.remaining_s),
        detail=progress.detail,
    )


def progress_from_ros(msg: wire_msg.Progress) -> StageProgress:
    """How far a stage is."""
    return StageProgress(
        stage=msg.stage,
        index=msg.stage_index,
        stages=msg.stages,
        status=msg.status,
        done=msg.done,
        total=msg.total,
        unit=msg.unit,
        rate_hz=msg.rate_hz,
        remaining_s=msg.remaining_s,
        detail=msg.detail,
    )
