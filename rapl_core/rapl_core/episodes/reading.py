"""Reading an episode's bag; everything that is wrong with it names the file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader

from rapl_core.episodes.bag_types import ACTION, IMAGE, JOINT_STATE, STATE, typestore
from rapl_core.episodes.joints import JointTrack
from rapl_core.episodes.summary import EpisodeSummary, read_summary
from rapl_core.episodes.writing import bag_file, file_sha256
from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.types import Episode


def read_episode(path: Path | str) -> Episode:
    """Return the episode in the folder ``path``.

    :raises CorruptFileError: if a file is missing, truncated or altered; names the file.
    """
    path = Path(path)
    summary = read_summary(path)
    messages = _messages(path, summary, (IMAGE, STATE, ACTION))
    states, actions = messages[STATE], messages[ACTION]
    with _naming(bag_file(path)):
        return Episode(
            episode_id=summary.episode_id,
            task=summary.task,
            world=summary.world,
            purpose=summary.purpose,
            controller=summary.controller,
            frames=_frames(messages[IMAGE]),
            states=np.stack([state.values for state in states]),
            actions=np.stack([action.values for action in actions]),
            stamps_ns=np.array([_stamp_ns(state.header) for state in states], dtype=np.int64),
            human_rewards=(
                np.array([state.human_reward for state in states]) if summary.has_truth else None
            ),
            success=summary.success,
            behaviour=summary.behaviour,
        )


def read_frames(path: Path | str) -> NDArray[np.uint8]:
    """Return the pictures (T + 1, H, W, 3) of the episode in the folder ``path``.

    :raises CorruptFileError: if a file is missing, truncated or altered; names the file.
    """
    path = Path(path)
    images = _messages(path, read_summary(path), (IMAGE,))[IMAGE]
    with _naming(bag_file(path)):
        return _frames(images)


def read_joints(path: Path | str) -> JointTrack | None:
    """Return the robot's joints in the episode in the folder ``path``; None: not recorded.

    :raises CorruptFileError: if a file is missing, truncated or altered; names the file.
    """
    path = Path(path)
    joints = _messages(path, read_summary(path), (JOINT_STATE,))[JOINT_STATE]
    if not joints:
        return None
    with _naming(bag_file(path)):
        return JointTrack(
            names=tuple(joints[0].name),
            positions=np.stack([joint.position for joint in joints]),
            velocities=np.stack([joint.velocity for joint in joints]),
        )


def _messages(path: Path, summary: EpisodeSummary, kinds: tuple[str, ...]) -> dict[str, list[Any]]:
    """The messages of some types, in order; the file is checked against its hash first."""
    file = bag_file(path)
    with _naming(file):
        if file_sha256(file) != summary.sha256:
            raise CorruptFileError(f"{file} is truncated or was altered: its hash differs")
        found: dict[str, list[Any]] = {kind: [] for kind in kinds}
        store = typestore()
        with Reader(path) as reader:
            wanted = [c for c in reader.connections if c.msgtype in kinds]
            for connection, _, data in reader.messages(connections=wanted) if wanted else ():
                kind = connection.msgtype
                found[kind].append(store.deserialize_cdr(data, kind))
        instants = summary.steps + 1
        expected = {IMAGE: instants, STATE: instants, ACTION: summary.steps}
        for kind, messages in found.items():
            if len(messages) != expected.get(kind, len(messages)):
                raise CorruptFileError(
                    f"{file} has {len(messages)} messages {kind}, expected {expected[kind]}"
                )
        return found


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    """Whatever goes wrong inside is the fault of ``file``.

    The bag library raises errors of many kinds on damaged data, hence the broad net.
    """
    try:
        yield
    except CorruptFileError:
        raise
    except RaplError as error:
        raise CorruptFileError(f"{file} holds no episode: {error}") from error
    except Exception as error:
        raise CorruptFileError(f"{file} cannot be read: {error}") from error


def _frames(images: list[Any]) -> NDArray[np.uint8]:
    height, width = images[0].height, images[0].width
    return np.stack([image.data.reshape(height, width, 3) for image in images])


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
