"""The node ``learner``: SAC from topics; states in, actions out, rewards when they come."""

import math
import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
import torch._dynamo  # torch would at the first optimiser: seconds that a callback must not take
from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Evaluate, Train
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_srvs.srv import Trigger

from rapl_core.errors import RaplError
from rapl_core.policies import SacConfig, SacTrainer, ScheduleConfig
from rapl_ros import conversions, qos, topics
from rapl_ros.background import wakeable_future
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.learner_session import AfterSwap, LearnerSession, fresh_or_refuse
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.relabelling import RelabellingPort
from rapl_ros.rounds import RoundLostError, RoundsStoppedError
from rapl_ros.session_rounds import SessionRounds, Tallies
from rapl_ros.waiting import Waiting
from rapl_ros.wire import PolicyRecord, World

TICK_S = 0.5
"""Between two looks at deadlines, and between two Metrics."""

GIVEN_OTHERWISE = ("steps", "worlds")
"""Of the schedule: the goal says how many steps, world_info how many worlds."""


@dataclass(frozen=True)
class LearnerConfig:
    """Parameters of the learner beside those of SAC and its schedule."""

    run_folder: Path = Path(".")
    """Run folder: gets policies/ and metrics/."""
    seed: int = field(default=0, metadata={"minimum": 0})
    """Starts, exploration, initial weights and batches follow from it."""
    reward_deadline_s: float = field(default=15.0, metadata={"minimum": 1.0, "maximum": 3600.0})
    """Seconds of wall time in which the reward of an episode must come while ot_reward lives;
    then the episode is dropped."""
    after_swap: AfterSwap = "empty"
    """What becomes of the replay buffer when rewards come from another encoder. empty: it is
    emptied. relabel: no round begins until what it holds was rewarded again, for which its
    episodes must have been recorded."""
    relabel_deadline_s: float = field(default=120.0, metadata={"minimum": 1.0, "maximum": 3600.0})
    """Seconds of wall time without any new reward after which episodes that still lack theirs are
    dropped (relabel)."""
    threads: int = field(default=1, metadata={"minimum": 1, "maximum": 64})
    """Threads of torch; for networks of this size one is the fastest."""


class LearnerNode(RaplNode):
    """Trains and evaluates a policy in rounds: one episode of every world at a time.

    Subscribes ``state``, ``reward``, ``world_info``. Publishes ``action``, ``metrics``
    (rapl_msgs/Metrics), ``policy_info`` (rapl_msgs/PolicyInfo, latched). Serves ``~/train``
    (rapl_msgs/Train) and ``~/evaluate`` (rapl_msgs/Evaluate), one goal of both at a time, and
    ``~/save`` (std_srvs/Trigger). Calls ``simulator/reset`` and ``ot_reward/reward_again``.

    A round begins only when simulator and ot_reward are there and rewards keep up. Gradient steps
    run on a thread of their own; the callback that ends a block of steps waits for those of the
    block before, normally not at all and never longer than one block takes.

    After an encoder swap the replay buffer is emptied, for its rewards mean something else, or its
    episodes are rewarded again (``after_swap``).
    """

    def __init__(self, **options: Any) -> None:
        peers = (topics.SIMULATOR, topics.OT_REWARD)
        super().__init__(topics.LEARNER, peers=peers, **options)
        self.config = declare_config(self, LearnerConfig())
        self._sac = declare_config(self, SacConfig(), "sac")
        self._schedule = declare_config(
            self, ScheduleConfig(), "schedule", left_out=GIVEN_OTHERWISE
        )
        torch.set_num_threads(self.config.threads)
        self._session: LearnerSession | None = None
        self._world: World | None = None
        self._goal: ServerGoalHandle | None = None
        self._savers: list[Future] = []
        self._swaps = 0
        self._metrics = self.publish_to(wire_msg.Metrics, topics.METRICS, qos.event())
        self._policies = self.publish_to(wire_msg.PolicyInfo, topics.POLICY_INFO, qos.latched())
        self._waiting = Waiting(self, self._is_cancelled)
        again = RelabellingPort(self, self._waiting, self.config.relabel_deadline_s)
        self._rounds = SessionRounds(self, self._waiting, again, self.config.seed)
        self.subscribe_to(wire_msg.Reward, topics.REWARD, self._on_reward, qos.event())
        self.subscribe_to(wire_msg.WorldInfo, topics.WORLD_INFO, self._on_world, qos.latched())
        # Its callback waits for the round to end; in the node's own group it would stop all others.
        waits = ReentrantCallbackGroup()
        self.create_service(Trigger, topics.SAVE, self._on_save, callback_group=waits)
        self._servers = [
            ActionServer(
                self,
                kind,
                name,
                execute,
                goal_callback=self._on_goal,
                handle_accepted_callback=self._on_accepted,
                cancel_callback=self._on_cancel,
            )
            for kind, name, execute in (
                (Train, topics.TRAIN, self._train),
                (Evaluate, topics.EVALUATE, self._evaluate),
            )
        ]
        self.steady_timer(TICK_S, self._tick)
        self.heartbeat.report("waiting", "for a goal")

    def close(self) -> None:
        """End the gradient steps under way."""
        if self._session is not None:
            self._session.close()

    # Goals

    def _on_goal(self, _: Any) -> GoalResponse:
        return GoalResponse.ACCEPT if self._goal is None else GoalResponse.REJECT

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        self._goal = goal
        goal.execute()

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self._waiting.wake()
        return CancelResponse.ACCEPT

    def _is_cancelled(self) -> bool:
        return self._goal is not None and self._goal.is_cancel_requested

    async def _train(self, goal: ServerGoalHandle) -> Train.Result:
        result = Train.Result()
        try:
            await self._waiting.until("for world_info", lambda: self._world is not None)
            session = self._open(goal.request.steps, goal.request.resume)
            try:
                await self._learn(session, goal)
            except RoundsStoppedError:  # between two rounds: a checkpoint may be written
                await self._save(session)
                raise
            result.success = True
            result.message = f"{session.learning.schedule.steps} steps"
        except Exception as error:
            result.message = self._reason(error)
        if self._session is not None:
            result.policy_id = self._session.policy_id
            result.metrics = self._metrics_now(self._session)
        self._end(goal, result)
        return result

    async def _evaluate(self, goal: ServerGoalHandle) -> Evaluate.Result:
        result = Evaluate.Result()
        try:
            await self._waiting.until("for world_info", lambda: self._world is not None)
            session, trainer = self._policy(goal.request.policy_id)
            rounds = -(-max(1, goal.request.episodes) // session.worlds)
            # Evaluations during training have used up the numbers below.
            first = session.learning.schedule.first_evaluation_episode
            tallies = await self._rounds.evaluate(
                session,
                trainer,
                range(first, first + rounds),
                goal.request.seed,
                lambda ended: _feed_back(goal, session, ended),
                goal.request.policy_id,
            )
            found = session.summarise(tallies, goal.request.episodes)
            result.success_rate = found.success_rate
            result.human_return_mean = found.human_return_mean
            result.reward_mean = found.reward_mean
            result.episode_ids = list(found.episode_ids)
            result.success = True
            result.message = f"{found.episodes} episodes"
        except Exception as error:
            result.message = self._reason(error)
        self._end(goal, result)
        return result

    def _reason(self, error: Exception) -> str:
        """In a line; what is no RaplError is a fault of ours and logged in full."""
        if isinstance(error, RaplError):
            return str(error)
        self.get_logger().error("".join(traceback.format_exception(error)))
        return f"{type(error).__name__}: {error}"

    def _end(self, goal: ServerGoalHandle, result: Any) -> None:
        self._goal = None
        self.heartbeat.report("waiting", "for a goal")
        if result.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            self.get_logger().error(result.message)
            goal.abort()
        self._answer_savers(False, "no training is under way")

    # Sessions

    def _open(self, steps: int, resume: bool) -> LearnerSession:
        """A session for a training up to ``steps``; resumed from the newest checkpoint, if any."""
        if steps < 1:
            raise RaplError(f"steps is {steps}, expected 1 or more")
        session = self._make_session(steps)
        newest = session.checkpoints.latest()
        if not resume:
            fresh_or_refuse(session)
        elif newest is not None:
            session.resume(newest)
            self.get_logger().info(f"goes on from {newest}")
        self._replace_session(session)
        return session

    def _make_session(self, steps: int) -> LearnerSession:
        assert self._world is not None
        schedule = replace(self._schedule, steps=steps, worlds=self._world.worlds)
        return LearnerSession(
            self._world,
            self._sac,
            schedule,
            self.config.seed,
            self.config.run_folder,
            self.config.after_swap,
            lambda: self.diagnostics.shares.of("sac"),
        )

    def _replace_session(self, session: LearnerSession) -> None:
        if self._session is not None:
            self._session.close()
        self._session, self._swaps = session, 0

    def _policy(self, policy_id: str) -> tuple[LearnerSession, SacTrainer]:
        """The policy to evaluate: the named one, else the current, else the newest on disk."""
        session = self._session
        if session is None:
            session = self._make_session(self._schedule.steps)
            newest = session.checkpoints.latest()
            if newest is None and not policy_id:
                raise RaplError(f"no policy: nothing was trained and {session.folder} has none")
            if newest is not None:
                session.resume(newest)
            self._replace_session(session)
        if not policy_id:
            session.learning.settle()
            return session, session.learning.trainer
        known = {path.name: path for path in session.checkpoints.all()}
        if policy_id not in known:
            raise RaplError(f"unknown policy '{policy_id}'; known: {', '.join(known) or 'none'}")
        current = session.learning.trainer
        trainer = SacTrainer(
            current.observation_size, current.action_size, self._sac, self.config.seed
        )
        trainer.load(known[policy_id])
        return session, trainer

    # Training

    async def _learn(self, session: LearnerSession, goal: ServerGoalHandle) -> None:
        schedule = session.learning.schedule
        while not schedule.finished:
            self._waiting.check_cancelled()
            if self._savers:
                await self._save(session)
            if not await self._rounds.train(session):
                continue
            if schedule.evaluation_due:
                await self._rounds.evaluate_as_scheduled(session)
            metrics = self._metrics_now(session)
            self._metrics.publish(metrics)
            goal.publish_feedback(Train.Feedback(metrics=metrics))
            if schedule.checkpoint_due:
                await self._save(session)

    async def _save(self, session: LearnerSession) -> None:
        """Write a checkpoint when the rewards of all that has ended are in it."""
        while session.unrewarded > 0 and not self._waiting.lack():
            await self._waiting.next_change()
        path = session.save()
        points = session.curve.points
        record = PolicyRecord(
            policy_id=path.name,
            uri=str(path.relative_to(self.config.run_folder)),
            steps=session.learning.schedule.steps,
            success_rate=points[-1].success_rate if points else math.nan,
        )
        self._policies.publish(conversions.policy_to_ros(record, self._now_ns))
        self._answer_savers(True, str(path))

    async def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answers when the checkpoint is on disk: at the end of the round under way."""
        if self._goal is None or not isinstance(self._goal.request, Train.Goal):
            response.message = "no training is under way; its end wrote a checkpoint"
            return response
        saved = wakeable_future(self)
        self._savers.append(saved)
        response.success, response.message = await saved
        return response

    def _answer_savers(self, success: bool, message: str) -> None:
        savers, self._savers = self._savers, []
        for saver in savers:
            saver.set_result((success, message))

    # What arrives

    def _tick(self) -> None:
        session = self._session
        if session is not None:
            if topics.OT_REWARD in self.missing_peers():
                session.hold_deadlines()
            late = session.expire_rewards(self.config.reward_deadline_s)
            if late:
                self.diagnostics.count("late_rewards", len(late))
                self.diagnostics.warn_for(
                    BAD_INPUT_S, "rewards", f"no reward came for {late[0]} in time"
                )
            if session.metrics_failure:
                self.diagnostics.warn("metrics", session.metrics_failure)
            else:
                self.diagnostics.clear("metrics")
            if self._goal is not None:
                self._metrics.publish(self._metrics_now(session))
        self._waiting.wake()

    def _on_world(self, msg: wire_msg.WorldInfo) -> None:
        self._world = conversions.world_from_ros(msg)
        self._waiting.wake()

    def _on_reward(self, msg: wire_msg.Reward) -> None:
        session = self._session
        if session is None or msg.purpose == "demonstrate":
            return
        try:
            whose, trace = conversions.reward_from_ros(msg)
        except RaplError as error:
            self.diagnostics.error_for(BAD_INPUT_S, "bad reward", str(error))
            return
        session.reward(whose, trace, msg.reason)
        if trace is None:
            self.diagnostics.count("dropped_episodes")
            self.get_logger().warning(f"{msg.episode_id} has no reward: {msg.reason}")
        if session.swaps > self._swaps:
            self._swaps = session.swaps
            source = session.learning.reward_source
            what = {"empty": "is emptied", "relabel": "is rewarded again"}[self.config.after_swap]
            self.get_logger().warning(f"rewards now come from {source}: replay buffer {what}")
        self._waiting.wake()

    def peer_found(self, peer: str, restarted: bool) -> None:
        """A simulator that has restarted knows nothing of the round under way."""
        if peer == topics.SIMULATOR and restarted:
            self._rounds.abandon(RoundLostError("the simulator has restarted"))
        self._waiting.wake()

    def peer_lost(self, peer: str) -> None:
        """Without a simulator the round under way cannot go on, nor be cancelled."""
        if peer == topics.SIMULATOR:
            self._rounds.abandon(RoundLostError("the simulator is gone"))
        self._waiting.wake()

    def _metrics_now(self, session: LearnerSession) -> wire_msg.Metrics:
        return conversions.metrics_to_ros(session.metrics(), self._now_ns)

    @property
    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def _feed_back(goal: ServerGoalHandle, session: LearnerSession, tallies: Tallies) -> None:
    rate = session.summarise(tallies, len(tallies)).success_rate
    goal.publish_feedback(Evaluate.Feedback(done=len(tallies), success_rate=rate))


if __name__ == "__main__":
    main(LearnerNode)
