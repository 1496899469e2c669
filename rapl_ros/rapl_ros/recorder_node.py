"""The node ``recorder``: complete episodes to disk."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rapl_msgs.msg import Action, EpisodeInfo, State, WorldInfo
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import CompressedImage, Image, JointState

from rapl_core.episodes.store import EpisodeStore
from rapl_core.errors import RaplError, ShapeError
from rapl_ros import conversions, qos, topics
from rapl_ros.background import QueueFullError, Worker
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.episode_builder import (
    BuilderLimits,
    EpisodeBuilder,
    Joints,
    LostEpisode,
    Outcome,
    Recording,
)
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.wire import EpisodeRecord, World

EPISODES = "episodes"
"""Folder of the episodes in the run folder."""

WAITING_EPISODES = 64
"""Complete episodes that may wait for the disk: some 2 MB each."""

FINISH_S = 2.5
"""For those that wait when the node is told to end; the supervisor kills it 0.7 s later."""


@dataclass(frozen=True)
class RecorderConfig:
    """Parameters of the recorder."""

    run_folder: Path = Path("runs/untitled")
    """Folder of the run; episodes go to its folder ``episodes``."""
    purposes: tuple[str, ...] = field(
        default=("demonstrate", "test", "evaluate"),
        metadata={"choices": ("demonstrate", "test", "evaluate", "train")},
    )
    """Episodes of these purposes are recorded."""
    image_transport: Literal["raw", "compressed"] = "raw"
    """What the camera publishes."""
    spare_megabytes: int = field(default=128, metadata={"minimum": 1, "maximum": 65536})
    """Memory for pictures that no state has named (yet); kept for 10 s at most."""


class RecorderNode(RaplNode):
    """Joins images, states, actions and joints into episodes and writes each as a bag.

    Subscribes ``state`` (rapl_msgs/State), ``action`` (rapl_msgs/Action), ``world_info``
    (rapl_msgs/WorldInfo), and of each world ``camera/image_raw`` (sensor_msgs/Image, or
    ``camera/image_raw/compressed``, sensor_msgs/CompressedImage) and ``joint_states``
    (sensor_msgs/JointState). Publishes ``episode`` (rapl_msgs/EpisodeInfo) when one is on disk.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.RECORDER, peers=[topics.SIMULATOR], **options)
        self.config = declare_config(self, RecorderConfig())
        self._store = EpisodeStore(self.config.run_folder / EPISODES)
        self._builder = EpisodeBuilder(
            self.config.purposes, BuilderLimits(spare_megabytes=self.config.spare_megabytes)
        )
        self._writer = Worker(self, "episode writer", WAITING_EPISODES)
        self._unwritten: dict[str, None] = {}
        """Ids of the episodes that wait for the disk, in order; the writer takes them out."""
        self._world: World | None = None
        self._subscribed_worlds = 0
        self._cameras: dict[str, Subscription] = {}
        self._episodes = self.publish_to(EpisodeInfo, topics.EPISODE, qos.event())
        self.subscribe_to(State, topics.STATE, self._on_state, qos.stream())
        self.subscribe_to(Action, topics.ACTION, self._on_action, qos.stream())
        self.subscribe_to(WorldInfo, topics.WORLD_INFO, self._on_world_info, qos.latched())
        self.steady_timer(1.0, self._expire)
        self.steady_timer(0.2, self._look_for_cameras)

    def _on_world_info(self, msg: WorldInfo) -> None:
        self._world = conversions.world_from_ros(msg)
        for world in range(self._subscribed_worlds, self._world.worlds):
            self._subscribe_to_camera(world)
            self.subscribe_to(
                JointState,
                topics.world_topic(topics.JOINT_STATES, world),
                self._on_joints,
                qos.stream(),
                overridable=True,
            )
        self._subscribed_worlds = max(self._subscribed_worlds, self._world.worlds)
        self._look_for_cameras()

    def _look_for_cameras(self) -> None:
        """Report that it records only when it sees all cameras: a demonstrator waits for that."""
        if self._world is None:
            self.heartbeat.report("waiting", "for world_info")
            return
        absent = [
            topic
            for topic, subscription in self._cameras.items()
            if subscription.get_publisher_count() == 0
        ]
        if absent:
            self.heartbeat.report("waiting", f"for a publisher of {absent[0]}")
        else:
            self.heartbeat.report("active", f"{self._world.task}, {self._world.worlds} worlds")

    def _subscribe_to_camera(self, world: int) -> None:
        if self.config.image_transport == "compressed":
            kind, topic = CompressedImage, topics.CAMERA_COMPRESSED
            convert = conversions.compressed_image_from_ros
        else:
            kind, topic = Image, topics.CAMERA_IMAGE
            convert = conversions.image_from_ros
        topic = topics.world_topic(topic, world)
        on_image = partial(self._on_image, topic, convert)
        self._cameras[topic] = self.subscribe_to(
            kind, topic, on_image, qos.stream(), overridable=True
        )

    def _on_image(self, topic: str, convert: Any, msg: Any) -> None:
        try:
            frame = convert(msg)
        except ShapeError as error:
            self.diagnostics.warn_for(BAD_INPUT_S, f"image on {topic}", str(error))
            self.diagnostics.count("refused_images")
            return
        key = conversions.key_from_ros(msg.header)
        self._handle(self._builder.add_image(key, frame, time.monotonic()))

    def _on_state(self, msg: State) -> None:
        try:
            instant = conversions.state_from_ros(msg)
        except ShapeError as error:
            self.diagnostics.warn_for(BAD_INPUT_S, "state", str(error))
            self.diagnostics.count("refused_states")
            return
        self._handle(self._builder.add_state(instant, time.monotonic()))

    def _on_action(self, msg: Action) -> None:
        try:
            command = conversions.action_from_ros(msg)
        except ShapeError:  # the simulator ignores it too, and says so
            self.diagnostics.count("refused_actions")
            return
        if self._world is None or len(command.values) != len(self._world.action_names):
            self.diagnostics.count("refused_actions")
            return
        self._handle(self._builder.add_action(command))

    def _on_joints(self, msg: JointState) -> None:
        joints = Joints(tuple(msg.name), np.array(msg.position), np.array(msg.velocity))
        self._handle(self._builder.add_joints(conversions.key_from_ros(msg.header), joints))

    def _expire(self) -> None:
        self._handle(self._builder.expire(time.monotonic()))

    def _handle(self, outcomes: Iterable[Outcome]) -> None:
        for outcome in outcomes:
            if isinstance(outcome, LostEpisode):
                self._lose(outcome.latest.episode_id, outcome.reason)
                continue
            episode_id = outcome.first.episode_id
            self._unwritten[episode_id] = None
            try:
                self._writer.submit(
                    partial(self._write, outcome, self._world.task if self._world else ""),
                    partial(self._on_written, episode_id),
                )
            except QueueFullError as error:
                del self._unwritten[episode_id]
                self._lose(episode_id, str(error))

    def _write(self, recording: Recording, task: str) -> EpisodeRecord:
        """Write an episode; in the writer's thread."""
        episode = recording.episode(task)
        path = self._store.add(episode, recording.joint_track(), recording.latest.terminated)
        self._unwritten.pop(episode.episode_id, None)
        return EpisodeRecord(
            key=recording.latest.key,
            episode_id=episode.episode_id,
            task=task,
            world=episode.world,
            purpose=episode.purpose,
            controller=episode.controller,
            behaviour=episode.behaviour,
            steps=episode.steps,
            uri=str(path.relative_to(self.config.run_folder)),
            human_return=None if episode.human_rewards is None else episode.human_return,
            success=episode.success,
        )

    def _on_written(self, episode_id: str, future: Future) -> None:
        error = future.exception()
        if isinstance(error, RaplError):
            self.diagnostics.error("recording", str(error))
            self._unwritten.pop(episode_id, None)
            self._lose(episode_id, str(error))
            return
        if error is not None:
            raise error
        self.diagnostics.clear("recording")
        self.diagnostics.count("recorded_episodes")
        self._episodes.publish(conversions.episode_record_to_ros(future.result()))

    def _lose(self, episode_id: str, reason: str) -> None:
        self.diagnostics.count("lost_episodes")
        self.get_logger().warning(f"episode {episode_id} is lost: {reason}")

    def close(self) -> None:
        """Write what is complete."""
        if not self._writer.finish(FINISH_S):
            lost = ", ".join(self._unwritten)
            self.get_logger().error(f"episodes that were not written in time: {lost}")


if __name__ == "__main__":
    main(RecorderNode)
