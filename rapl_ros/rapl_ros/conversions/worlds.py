"""States, actions, joints, worlds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from rapl_msgs import msg as wire_msg
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from rapl_ros.conversions.headers import floats_to_ros, header_to_ros, key_from_ros, time_to_ros
from rapl_ros.wire import (
    Command,
    Instant,
    JoinKey,
    World,
)


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
        human_reward=0.0 if instant.human_reward is None else float(instant.human_reward),
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
