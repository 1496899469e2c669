"""Writing an episode as a rosbag2 folder that ROS 2 tools and Foxglove open."""

import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from rapl_core.episodes.bag_types import ACTION, IMAGE, JOINT_STATE, STATE, typestore
from rapl_core.episodes.joints import JointTrack
from rapl_core.episodes.summary import SUMMARY_FILE, summarise, summary_to_json
from rapl_core.errors import RaplError
from rapl_core.types import Episode

TEMPORARY_PREFIX = ".writing-"
"""Of folders that are not complete; nobody reads them."""

NAMESPACE = "/rapl"
"""Of the topics in a bag: as the graph publishes them, so that playing it back feeds the graph."""


class _Record(NamedTuple):
    """One message, ready to be stored."""

    kind: str
    stamp_ns: int
    data: memoryview


def write_episode(
    folder: Path | str,
    episode: Episode,
    joints: JointTrack | None = None,
    terminated: bool = False,
) -> Path:
    """Write ``episode`` to ``folder/<episode id>`` and return that path.

    Atomic: the folder appears complete and on disk, or not at all.

    :param folder: created if need be.
    :param joints: the robot's joints at each instant, if known.
    :param terminated: the task ended rather than the time.
    :raises RaplError: if the episode is already there, or ``folder`` cannot be written.
    :raises ShapeError: if ``joints`` are of another number of instants.
    """
    folder = Path(folder)
    if joints is not None:
        joints.check_instants(episode.steps + 1)
    target = folder / episode.episode_id
    if target.exists():
        raise RaplError(f"episode {episode.episode_id} is already stored in {folder}")
    temporary = folder / f"{TEMPORARY_PREFIX}{uuid.uuid4().hex}"
    bag = temporary / episode.episode_id
    try:
        temporary.mkdir(parents=True)
        _write_bag(bag, episode, joints, terminated)
        summary = summarise(episode, terminated, file_sha256(bag_file(bag)))
        (bag / SUMMARY_FILE).write_text(summary_to_json(summary), encoding="utf-8")
        for file in bag.iterdir():
            _flush(file)
        _flush(bag)
        bag.rename(target)
        _flush(folder)
    except OSError as error:
        raise RaplError(
            f"cannot write episode {episode.episode_id} to {folder}: {error}"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return target


def bag_file(path: Path) -> Path:
    """Return the .mcap file of the episode in the folder ``path``."""
    return path / f"{path.name}.mcap"


def file_sha256(file: Path) -> str:
    """Return the SHA-256 of a file in hex."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _flush(path: Path) -> None:
    """Have what was written to a file or folder on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write_bag(bag: Path, episode: Episode, joints: JointTrack | None, terminated: bool) -> None:
    prefix = NAMESPACE if episode.world == 0 else f"{NAMESPACE}/env_{episode.world}"
    topics = {
        IMAGE: f"{prefix}/camera/image_raw",
        STATE: f"{NAMESPACE}/state",
        ACTION: f"{NAMESPACE}/action",
    }
    if joints is not None:
        topics[JOINT_STATE] = f"{prefix}/joint_states"
    writer = Writer(bag, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    for key in ("episode_id", "task", "purpose", "controller", "behaviour"):
        writer.set_custom_data(key, str(getattr(episode, key)))
    with writer:
        connections: dict[str, Connection] = {
            kind: writer.add_connection(topic, kind, typestore=typestore())
            for kind, topic in topics.items()
        }
        for record in _records(episode, joints, terminated):
            writer.write(connections[record.kind], record.stamp_ns, record.data)


def _records(episode: Episode, joints: JointTrack | None, terminated: bool) -> Iterator[_Record]:
    """The messages in the order in which the graph sends them: image, joints, state, action."""
    store = typestore()
    world_frame = f"env_{episode.world}/world"
    camera_frame = f"env_{episode.world}/camera_optical_frame"
    for step, stamp in enumerate(int(s) for s in episode.stamps_ns):
        messages = [
            (IMAGE, _image(_header(stamp, camera_frame), episode.frames[step])),
            (STATE, _state(episode, step, _header(stamp, world_frame), camera_frame, terminated)),
        ]
        if joints is not None:
            header = _header(stamp, world_frame)
            messages.insert(1, (JOINT_STATE, _joint_state(header, joints, step)))
        if step < episode.steps:
            messages.append((ACTION, _action(episode, step, _header(stamp, world_frame))))
        for kind, message in messages:
            yield _Record(kind, stamp, store.serialize_cdr(message, kind))


def _message(kind: str, **fields: Any) -> Any:
    """A message of a type that is known only at run time, hence without static types."""
    return typestore().types[kind](**fields)


def _header(stamp_ns: int, frame_id: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = _message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return _message("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _image(header: Any, frame: np.ndarray[Any, np.dtype[np.uint8]]) -> Any:
    height, width, _ = frame.shape
    return _message(
        IMAGE,
        header=header,
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * width,
        data=np.ascontiguousarray(frame).reshape(-1),
    )


def _joint_state(header: Any, joints: JointTrack, step: int) -> Any:
    return _message(
        JOINT_STATE,
        header=header,
        name=list(joints.names),
        position=np.ascontiguousarray(joints.positions[step], dtype=np.float64),
        velocity=np.ascontiguousarray(joints.velocities[step], dtype=np.float64),
        effort=np.zeros(0),
    )


def _state(episode: Episode, step: int, header: Any, camera_frame: str, terminated: bool) -> Any:
    is_last = step == episode.steps
    truth = episode.human_rewards
    return _message(
        STATE,
        header=header,
        image=_message("std_msgs/msg/Header", stamp=header.stamp, frame_id=camera_frame),
        world=int(episode.world),
        episode_id=episode.episode_id,
        purpose=episode.purpose,
        controller=episode.controller,
        step=step,
        is_last=is_last,
        terminated=is_last and terminated,
        values=np.ascontiguousarray(episode.states[step], dtype=np.float64),
        has_truth=truth is not None,
        human_reward=float("nan") if truth is None else float(truth[step]),
        success=is_last and bool(episode.success),
    )


def _action(episode: Episode, step: int, header: Any) -> Any:
    return _message(
        ACTION,
        header=header,
        world=int(episode.world),
        episode_id=episode.episode_id,
        step=step,
        controller=episode.controller,
        behaviour=episode.behaviour,
        values=np.ascontiguousarray(episode.actions[step], dtype=np.float64),
    )
