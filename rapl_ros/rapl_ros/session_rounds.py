"""The rounds of a training and of its evaluations; one that is lost is played again."""

from collections.abc import Callable, Sequence

from rapl_core.errors import RaplError
from rapl_core.policies import SacTrainer
from rapl_ros.calls import CallError
from rapl_ros.learner_session import LearnerSession
from rapl_ros.node import RaplNode
from rapl_ros.players import EpisodeTally, EvaluationPlayer
from rapl_ros.relabelling import RelabellingPort
from rapl_ros.rounds import RoundLostError, Rounds
from rapl_ros.waiting import FOR_REWARDS, Waiting

Tallies = list[tuple[int, EpisodeTally]]
"""Number and tally of each episode."""


class SessionRounds:
    """Plays what a session needs next.

    :param node: its heartbeat says what goes on, its diagnostics count lost rounds.
    :param again: has rewards renewed after a swap.
    :param seed: of the starts of training.
    """

    def __init__(self, node: RaplNode, waiting: Waiting, again: RelabellingPort, seed: int) -> None:
        self._node, self._waiting, self._seed = node, waiting, seed
        self._again = again
        self._rounds = Rounds(node)

    def abandon(self, error: RoundLostError) -> None:
        """Give up the round under way, if any."""
        self._rounds.abandon(error)

    async def train(self, session: LearnerSession) -> bool:
        """Play the next round of training when its rewards are there; returns whether it ended.

        :raises RoundsStoppedError: if the goal is cancelled before it begins.
        """
        await self._waiting.until_ready(lambda: session.may_begin)
        while session.needs_relabelling:
            await self._again.relabel(session)
            await self._waiting.until_ready(lambda: session.may_begin)
        schedule = session.learning.schedule
        player = session.begin_round()
        what = f"{schedule.steps} of {schedule.config.steps} steps"
        self._node.heartbeat.report("active", what)
        try:
            await self._rounds.play(player, "train", schedule.next_episode, self._seed)
        except (RoundLostError, CallError) as error:
            self._lose(session, list(player.tallies), error)
            return False
        session.end_round(player)
        return True

    async def evaluate_as_scheduled(self, session: LearnerSession) -> None:
        """The evaluation that the schedule asks for now."""
        schedule = session.learning.schedule
        session.learning.settle()
        first = schedule.first_evaluation_episode
        numbers = range(first, first + schedule.evaluation_rounds)
        tallies = await self.evaluate(session, session.learning.trainer, numbers, self._seed)
        found = session.summarise(tallies, schedule.config.evaluate_episodes)
        session.evaluated(found)
        self._node.get_logger().info(
            f"after {schedule.steps} steps: success {found.success_rate:.0%} over "
            f"{found.episodes} episodes, return of r* {found.human_return_mean:.2f}"
        )

    async def evaluate(
        self,
        session: LearnerSession,
        trainer: SacTrainer,
        numbers: Sequence[int],
        seed: int,
        on_round: Callable[[Tallies], None] = lambda tallies: None,
        policy_id: str = "",
    ) -> Tallies:
        """Play these episodes in every world without exploring and wait for their rewards.

        :param on_round: called after each round with all that has ended.
        :param policy_id: of ``trainer``; empty: the session's current one.
        :raises RoundsStoppedError: if the goal is cancelled.
        """
        tallies: Tallies = []
        waiting = list(numbers)
        while waiting:
            self._waiting.check_cancelled()
            await self._waiting.until_ready(lambda: session.keeps_up)
            player = EvaluationPlayer(
                session.task, trainer, f"sac-{policy_id or session.policy_id}"
            )
            self._node.heartbeat.report("active", f"evaluation, rounds left: {len(waiting)}")
            try:
                await self._rounds.play(player, "evaluate", waiting[0], seed)
            except (RoundLostError, CallError) as error:
                self._lose(session, list(player.tallies), error)
                continue
            ended = list(player.tallies.values())
            session.expect_rewards(ended)
            number = waiting.pop(0)
            tallies += [(number, tally) for tally in ended]
            on_round(tallies)
        await self._waiting.until(FOR_REWARDS, lambda: session.unrewarded == 0)
        return tallies

    def _lose(self, session: LearnerSession, episode_ids: list[str], error: RaplError) -> None:
        """The round is played again: the same starts, other actions."""
        self._node.diagnostics.count("lost_rounds")
        self._node.get_logger().warning(f"round lost, it is played again: {error}")
        session.lose_round(episode_ids, str(error))
