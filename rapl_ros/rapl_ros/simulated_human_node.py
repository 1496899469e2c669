"""The node ``simulated_human``: ranks videos as a person would, by returns that it knows."""

import math
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rapl_msgs.msg import EpisodeInfo, Query
from rapl_msgs.srv import GetQuery, ListRankings, SubmitRanking

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError
from rapl_core.preferences import SimulatedHuman
from rapl_core.types import Ranking
from rapl_ros import conversions, qos, topics
from rapl_ros.calls import call, pause
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import ConfigParameters

IDLE_S = 0.2
RETRY_S = 1.0


@dataclass(frozen=True)
class SimulatedHumanConfig:
    """Parameters of the simulated human."""

    rankings: int = field(default=0, metadata={"minimum": 0})
    """Rankings to give in all, those of earlier starts included. May change at run time."""
    annotator: str = "simulated"
    """Name under which the rankings are stored."""
    run_folder: Path = Path(".")
    """Run folder: returns of episodes that were recorded before this node began to listen."""
    seed: int = field(default=0, metadata={"minimum": 0})
    """Errors follow from it."""
    beta: float = math.inf
    """Rationality, in units of 1 / return: the smaller, the more random. inf: never errs."""
    mistakes: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of rankings in which two neighbours are exchanged."""
    equal_threshold: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1e9})
    """Videos whose returns differ by at most this are ranked equal."""
    skip: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 1.0})
    """Share of queries that are not answered."""


class SimulatedHumanNode(RaplNode):
    """A client of the same services as a person.

    Subscribes ``episode`` (rapl_msgs/EpisodeInfo) for the true returns. Calls
    ``preference/get_query``, ``preference/submit_ranking`` and ``preference/list_rankings``.
    Reports on its heartbeat how many rankings it has given; does nothing until ``rankings`` is set.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIMULATED_HUMAN, peers=(topics.PREFERENCE,), **options)
        self._wishes = ConfigParameters(self, SimulatedHumanConfig(), writable=("rankings",))
        self._returns: dict[str, float] = {}
        self._episodes = EpisodeStore(self._wishes.value.run_folder / "episodes")
        self.subscribe_to(EpisodeInfo, topics.EPISODE, self._on_episode, qos.event())
        self._get_query, self._submit, self._list = (
            self.create_client(kind, topics.of_node(name, topics.PREFERENCE))
            for kind, name in (
                (GetQuery, topics.GET_QUERY),
                (SubmitRanking, topics.SUBMIT_RANKING),
                (ListRankings, topics.LIST_RANKINGS),
            )
        )
        self._start = self.steady_timer(0.05, self._begin)

    def _begin(self) -> None:
        self._start.cancel()
        assert self.executor is not None
        self.executor.create_task(self._live)

    async def _live(self) -> None:
        while True:
            try:
                await self._rank_what_is_wanted()
                await pause(self, IDLE_S)
            except RaplError as error:
                self.heartbeat.report("waiting", str(error))
                await pause(self, RETRY_S)

    async def _rank_what_is_wanted(self) -> None:
        wanted = self._wishes.value.rankings
        if wanted == 0:
            self.heartbeat.report("waiting", "for the parameter 'rankings'")
            return
        annotator = self._wishes.value.annotator
        stored = await call(self, self._list, ListRankings.Request(annotator=annotator, limit=1))
        for given in range(stored.total, wanted):
            self.heartbeat.report("active", f"{given} of {wanted} rankings")
            await self._rank_one(given)
        if stored.total < wanted:
            self.get_logger().info(f"gave {wanted - stored.total} rankings")
        self.heartbeat.report("waiting", f"done: {wanted} of {wanted} rankings")

    async def _rank_one(self, number: int) -> None:
        config = self._wishes.value
        asked = await call(self, self._get_query, GetQuery.Request(annotator=config.annotator))
        if not asked.success:
            raise RaplError(asked.message)
        began_s = time.monotonic()
        answer = self._answer(asked.query, number)
        ranking = Ranking(
            ranking_id=uuid.uuid4().hex,
            annotator=config.annotator,
            episode_ids=tuple(asked.query.episode_ids),
            ranks=answer.ranks,
            verdict=answer.verdict,
            query_id=asked.query.query_id,
            response_s=time.monotonic() - began_s,
            created_ns=time.time_ns(),
        )
        request = SubmitRanking.Request(ranking=conversions.ranking_to_ros(ranking))
        stored = await call(self, self._submit, request)
        if not stored.success:
            raise RaplError(stored.message)

    def _answer(self, query: Query, number: int) -> Any:
        config = self._wishes.value
        human = SimulatedHuman(
            np.random.default_rng([config.seed, number]),
            beta=config.beta,
            mistakes=config.mistakes,
            equal_threshold=config.equal_threshold,
            skip=config.skip,
        )
        return human.answer([self._return_of(episode_id) for episode_id in query.episode_ids])

    def _return_of(self, episode_id: str) -> float:
        if episode_id not in self._returns:
            summary = self._episodes.summary(episode_id)
            known = summary.human_return
            self._returns[episode_id] = math.nan if known is None else known
        return self._returns[episode_id]

    def _on_episode(self, msg: EpisodeInfo) -> None:
        self._returns[msg.episode_id] = msg.human_return if msg.has_truth else math.nan


if __name__ == "__main__":
    main(SimulatedHumanNode)
