"""After a swap of the encoder: the learner has what it learns from rewarded again."""

import time

from rapl_msgs.srv import RewardAgain

from rapl_core.errors import RaplError
from rapl_core.policies import Relabelling, RewardSource
from rapl_ros import conversions, topics
from rapl_ros.calls import CallError, call_peer, pause
from rapl_ros.learner_session import LearnerSession
from rapl_ros.node import RaplNode
from rapl_ros.progress import count_words
from rapl_ros.rounds import RoundsStoppedError
from rapl_ros.waiting import Waiting
from rapl_ros.wire import RewardsAgain

RETRY_S = 1.0
CALL_S = 75.0
"""For one batch; longer than ot_reward waits for the encoder."""


class RelabellingPort:
    """Asks ``ot_reward/reward_again``, batch by batch; no round goes on meanwhile.

    :param node: must watch ``ot_reward``.
    :param deadline_s: without any answer for so long, what is left is dropped.
    """

    def __init__(self, node: RaplNode, waiting: Waiting, deadline_s: float) -> None:
        self._node, self._waiting, self._deadline_s = node, waiting, deadline_s
        self._client = node.create_client(
            RewardAgain, topics.of_node(topics.REWARD_AGAIN, topics.OT_REWARD)
        )

    async def relabel(self, session: LearnerSession) -> None:
        """Until all that the session holds is of one source.

        :raises RoundsStoppedError: if the goal is cancelled; what is outdated stays so then.
        """
        while session.needs_relabelling:
            relabelling = session.begin_relabelling()
            began_s = time.monotonic()
            await self._ask_for_all(relabelling)
            session.end_relabelling(relabelling)
            self._tell(relabelling, time.monotonic() - began_s)

    async def _ask_for_all(self, relabelling: Relabelling) -> None:
        heard_s = time.monotonic()
        while not relabelling.is_done:
            self._waiting.check_cancelled()
            done = len(relabelling.rewards) + len(relabelling.lost)
            words = count_words("rewards again", done, relabelling.total, "episodes")
            self._node.heartbeat.report("active", words)
            if relabelling.asks_again:
                await pause(self._node, RETRY_S)
            try:
                answer = await self._ask(relabelling.next())
            except RoundsStoppedError:
                raise
            except RaplError as error:
                if time.monotonic() - heard_s > self._deadline_s:
                    relabelling.give_up(str(error))
                    return
                self._node.heartbeat.report("waiting", f"{words}; {error}")
                await pause(self._node, min(RETRY_S, self._deadline_s / 4))
                continue
            heard_s = time.monotonic()
            rewards = {whose.episode_id: trace.values for whose, trace in answer.rewards}
            relabelling.take(_source_of(answer), rewards, answer.missing)

    async def _ask(self, episode_ids: tuple[str, ...]) -> RewardsAgain:
        """One batch.

        :raises CallError: if ot_reward is not there, dies meanwhile, refuses, or is late.
        """
        response = await call_peer(
            self._node,
            self._client,
            RewardAgain.Request(episode_ids=list(episode_ids)),
            topics.OT_REWARD,
            min(CALL_S, self._deadline_s),
            self._waiting.check_cancelled,
        )
        if not response.success:
            raise CallError(response.message)
        return conversions.rewards_again_from_ros(response)

    def _tell(self, relabelling: Relabelling, took_s: float) -> None:
        node, lost = self._node, len(relabelling.lost)
        node.diagnostics.count("relabelled_episodes", len(relabelling.rewards))
        node.get_logger().info(
            f"{len(relabelling.rewards)} episodes rewarded again by {relabelling.source} "
            f"in {took_s:.1f} s"
        )
        if lost:
            node.diagnostics.count("dropped_episodes", lost)
            reasons = sorted(set(relabelling.lost.values()))
            node.get_logger().warning(
                f"{lost} of {relabelling.total} episodes could not be rewarded again and are "
                f"dropped: {'; '.join(reasons[:3])}"
            )


def _source_of(answer: RewardsAgain) -> RewardSource | None:
    """Of all rewards of an answer; None where it has none."""
    if not answer.rewards:
        return None
    return RewardSource(answer.encoder, answer.version, answer.rewards[0][1].scale)
