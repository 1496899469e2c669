"""The node ``demonstrator``: scripted behaviours, preferred and disliked."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rapl_msgs.action import Collect
from rapl_msgs.msg import Action, EpisodeInfo, State, WorldInfo
from rapl_msgs.srv import Reset
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future

from rapl_core.errors import RaplError, ShapeError
from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics
from rapl_ros.background import wakeable_future
from rapl_ros.collection import Batch, Collection, CollectionGoal
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.wire import Command, Instant, World

TICK_S = 0.2
"""Between two looks at deadlines and cancellation."""


@dataclass(frozen=True)
class DemonstratorConfig:
    """Parameters of the demonstrator."""

    recording_deadline_s: float = field(default=15.0, metadata={"minimum": 1.0, "maximum": 3600.0})
    """Wall time after an episode's end in which it must be recorded; then another replaces it."""
    reset_deadline_s: float = field(default=5.0, metadata={"minimum": 0.5, "maximum": 3600.0})
    """Wall time in which the simulator must answer a reset; then it is asked again."""
    patience_s: float = field(default=60.0, metadata={"minimum": 1.0, "maximum": 86400.0})
    """Wall time without any progress after which a collection is given up."""


@dataclass
class _Job:
    """The goal under way."""

    goal_handle: ServerGoalHandle
    ended: Future
    """Its result is the reason why it failed; empty when complete or cancelled."""
    progress_s: float
    collection: Collection | None = None
    resets: dict[Future, tuple[Batch, float]] = field(default_factory=dict)
    early: dict[str, Instant] = field(default_factory=dict)
    """First states that came before the answer to their reset, by episode id."""


class DemonstratorNode(RaplNode):
    """Shows behaviours in the episodes that it has the simulator begin.

    Subscribes ``state`` (rapl_msgs/State), ``world_info`` (rapl_msgs/WorldInfo), ``episode``
    (rapl_msgs/EpisodeInfo). Publishes ``action`` (rapl_msgs/Action). Serves ``~/collect``
    (rapl_msgs/Collect), one goal at a time. Calls ``simulator/reset`` (rapl_msgs/Reset).
    """

    def __init__(self, **options: Any) -> None:
        peers = [topics.SIMULATOR, topics.RECORDER]
        super().__init__(topics.DEMONSTRATOR, peers=peers, **options)
        self.config = declare_config(self, DemonstratorConfig())
        self._world: World | None = None
        self._job: _Job | None = None
        self._actions = self.publish_to(Action, topics.ACTION, qos.stream())
        self.subscribe_to(State, topics.STATE, self._on_state, qos.stream())
        self.subscribe_to(WorldInfo, topics.WORLD_INFO, self._on_world_info, qos.latched())
        self.subscribe_to(EpisodeInfo, topics.EPISODE, self._on_episode, qos.event())
        self._reset = self.create_client(Reset, topics.of_node(topics.RESET, topics.SIMULATOR))
        self._collect = ActionServer(
            self,
            Collect,
            topics.COLLECT,
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.steady_timer(TICK_S, self._tick)
        self.heartbeat.report("waiting", "for a goal")

    # The goal

    def _on_goal(self, _: Collect.Goal) -> GoalResponse:
        return GoalResponse.ACCEPT if self._job is None else GoalResponse.REJECT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Collect.Result:
        job = _Job(goal_handle, wakeable_future(self), time.monotonic())
        self._job = job
        self._tick()
        failure = await job.ended
        self._job = None
        self.heartbeat.report("waiting", "for a goal")
        collection = job.collection
        result = Collect.Result(message=failure)
        if collection is not None:
            result.episode_ids = collection.recorded
            result.dropped = len(collection.dropped)
            result.success = collection.is_complete
        if result.success:
            result.message = f"{len(result.episode_ids)} episodes recorded"
            goal_handle.succeed()
            return result
        self._rest()
        if goal_handle.is_cancel_requested:
            result.message = "cancelled"
            goal_handle.canceled()
        else:
            self.get_logger().error(f"collection failed: {failure}")
            goal_handle.abort()
        return result

    def _tick(self) -> None:
        """Look after the goal under way: begin, resets, deadlines, cancellation."""
        job = self._job
        if job is None or job.ended.done():
            return
        now_s = time.monotonic()
        if job.goal_handle.is_cancel_requested:
            job.ended.set_result("cancelled")
            return
        self._retry_late_resets(job, now_s)
        if now_s - job.progress_s > self.config.patience_s:
            job.ended.set_result(f"no progress for {self.config.patience_s:g} s: {self._lack()}")
            return
        if self._world is None or self._lack():
            self.heartbeat.report("waiting", self._lack() or "no world_info")
            return
        if job.collection is None and not self._start(job, self._world):
            return
        self._go_on(job, now_s)

    def _start(self, job: _Job, world: World) -> bool:
        request = job.goal_handle.request
        goal = CollectionGoal(
            episodes=request.episodes,
            behaviours=tuple(request.behaviours),
            noise=request.noise,
            seed=request.seed,
            purpose=request.purpose or "demonstrate",
            first_episode=request.first_episode,
        )
        try:
            job.collection = Collection(get_task(world.task), goal, world.worlds)
        except RaplError as error:
            job.ended.set_result(str(error))
            return False
        self.heartbeat.report("active", f"{goal.episodes} episodes")
        return True

    def _go_on(self, job: _Job, now_s: float) -> None:
        collection = job.collection
        if collection is None:
            return
        dropped = len(collection.dropped)
        self._publish(collection.expire(now_s, self.config.recording_deadline_s))
        if len(collection.dropped) > dropped:
            self.diagnostics.count("unrecorded_episodes", len(collection.dropped) - dropped)
            self._feed_back(job)
        if collection.is_complete:
            job.ended.set_result("")
        elif collection.needs_reset and not job.resets:
            job.early.clear()
            for batch in collection.plan():
                self._send_reset(job, batch, now_s)

    def _feed_back(self, job: _Job) -> None:
        if job.collection is not None:
            done, dropped = len(job.collection.recorded), len(job.collection.dropped)
            job.goal_handle.publish_feedback(Collect.Feedback(done=done, dropped=dropped))

    def _lack(self) -> str:
        """What is missing to go on, or an empty string."""
        missing = [f"{peer} is missing" for peer in self.missing_peers()]
        recorder = self.peers[topics.RECORDER]
        if recorder.alive and recorder.status != "active":
            missing.append(f"recorder is {recorder.status} {recorder.detail}".rstrip())
        return ", ".join(missing)

    # Resets

    def _send_reset(self, job: _Job, batch: Batch, now_s: float) -> None:
        assert job.collection is not None
        goal = job.collection.goal
        request = Reset.Request(
            worlds=list(batch.worlds),
            purpose=goal.purpose,
            controller=topics.DEMONSTRATOR,
            episodes=batch.episodes,
            first_episode=batch.first_episode,
            seed=goal.seed,
        )
        future = self._reset.call_async(request)
        job.resets[future] = (batch, now_s)
        future.add_done_callback(partial(self._on_reset_answer, job))

    def _on_reset_answer(self, job: _Job, future: Future) -> None:
        batch, _ = job.resets.pop(future, (None, 0.0))
        if batch is None or job.collection is None or job is not self._job:
            return  # given up, or the goal has ended
        response = future.result()
        if not response.success:
            job.ended.set_result(f"simulator refuses a reset: {response.message}")
            return
        job.progress_s = time.monotonic()
        job.collection.begin(batch, response.episode_ids)
        for episode_id in response.episode_ids:
            if episode_id in job.early:
                self._answer(job, job.early.pop(episode_id))

    def _retry_late_resets(self, job: _Job, now_s: float) -> None:
        for future, (batch, sent_s) in list(job.resets.items()):
            if now_s - sent_s > self.config.reset_deadline_s:
                del job.resets[future]
                self._reset.remove_pending_request(future)
                self.diagnostics.count("late_resets")
                self._send_reset(job, batch, now_s)

    def _rest(self) -> None:
        """Let the worlds rest: nobody will answer their states."""
        if topics.SIMULATOR not in self.missing_peers():
            self._reset.call_async(Reset.Request(controller=""))

    # What arrives

    def _on_world_info(self, msg: WorldInfo) -> None:
        self._world = conversions.world_from_ros(msg)

    def _on_state(self, msg: State) -> None:
        job = self._job
        if job is None or msg.controller != topics.DEMONSTRATOR:
            return
        try:
            instant = conversions.state_from_ros(msg)
        except ShapeError as error:
            self.diagnostics.warn_for(BAD_INPUT_S, "state", str(error))
            return
        if job.resets and instant.step == 0:
            job.early[instant.episode_id] = instant
        self._answer(job, instant)

    def _answer(self, job: _Job, instant: Instant) -> None:
        if job.collection is None:
            return
        now_s = time.monotonic()
        command = job.collection.act(instant, now_s)
        if command is not None:
            job.progress_s = now_s
            self._publish([command])

    def _on_episode(self, msg: EpisodeInfo) -> None:
        job = self._job
        if job is None or job.collection is None:
            return
        now_s = time.monotonic()
        recorded = len(job.collection.recorded)
        self._publish(job.collection.record(msg.episode_id, now_s))
        if len(job.collection.recorded) > recorded:
            job.progress_s = now_s
            self._feed_back(job)
            self._go_on(job, now_s)

    def peer_found(self, peer: str, restarted: bool) -> None:
        """A simulator that has restarted knows nothing of the collection: reset it again.

        What is known of the world stays: its world_info may have come before its heartbeat.
        """
        if peer == topics.SIMULATOR and restarted and self._job and self._job.collection:
            self._job.resets.clear()
            self._job.collection.interrupt()

    def _publish(self, commands: Iterable[Command]) -> None:
        for command in commands:
            self._actions.publish(conversions.action_to_ros(command))


if __name__ == "__main__":
    main(DemonstratorNode)
