"""The node ``simulated_human``: ranks videos as a person would, by returns that it knows."""

import math
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rapl_msgs.msg import EpisodeInfo, Query
from rapl_msgs.srv import GetProgress, GetQuery, ListRankings, SubmitRanking

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError
from rapl_core.preferences import Answer, HumanKnobs, SimulatedHuman
from rapl_core.preferences.wishes import Person, persons_from, wish_rewards
from rapl_core.tasks import get_task
from rapl_core.types import Ranking
from rapl_ros import conversions, qos, topics
from rapl_ros.calls import call, pause
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import ConfigParameters

IDLE_S = 0.2
RETRY_S = 1.0


@dataclass(frozen=True)
class SimulatedHumanConfig(HumanKnobs):
    """Parameters of the simulated human."""

    rankings: int = field(default=0, metadata={"minimum": 0})
    """Rankings to give in all, those of earlier starts included. May change at run time."""
    annotator: str = "simulated"
    """Name under which the rankings are stored."""
    people: str = ""
    """Several people instead of one, who take turns, as name:wish,name:wish, e.g.
    ann:task,ben:opposite. Wishes: task, opposite, progress, apart."""
    run_folder: Path = Path(".")
    """Run folder: returns of episodes that were recorded before this node began to listen."""
    seed: int = field(default=0, metadata={"minimum": 0})
    """Errors follow from it."""
    pace_s: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 3600.0})
    """Wall time between two answers: gives a strategy time to learn from them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.persons()

    def persons(self) -> tuple[Person, ...]:
        """Who ranks.

        :raises RaplError: if a part of `people` is not name:wish or its wish is unknown.
        """
        return persons_from(self.people) or (Person(self.annotator),)


class SimulatedHumanNode(RaplNode):
    """A client of the same services as a person.

    Subscribes ``episode`` (rapl_msgs/EpisodeInfo) for the true returns. Calls
    ``preference/get_query``, ``preference/submit_ranking``, ``preference/list_rankings`` and
    ``preference/get_progress``.
    Reports on its heartbeat how many rankings it has given; does nothing until ``rankings`` is set.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIMULATED_HUMAN, peers=(topics.PREFERENCE,), **options)
        self._wishes = ConfigParameters(self, SimulatedHumanConfig(), writable=("rankings",))
        self._returns: dict[tuple[str, str], float] = {}
        self._episodes = EpisodeStore(self._wishes.value.run_folder / "episodes")
        self.subscribe_to(EpisodeInfo, topics.EPISODE, self._on_episode, qos.event())
        self._get_query, self._submit, self._list, self._progress = (
            self.create_client(kind, topics.of_node(name, topics.PREFERENCE))
            for kind, name in (
                (GetQuery, topics.GET_QUERY),
                (SubmitRanking, topics.SUBMIT_RANKING),
                (ListRankings, topics.LIST_RANKINGS),
                (GetProgress, topics.GET_PROGRESS),
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
        persons = self._wishes.value.persons()
        given = {person: await self._count(person) for person in persons}
        asked = {person: await self._count(person, effective=False) for person in persons}
        before = sum(given.values())
        while sum(given.values()) < wanted:
            await self._strategy_is_ready()
            self.heartbeat.report("active", f"{sum(given.values())} of {wanted} rankings")
            person = min(persons, key=lambda person: asked[person])
            given[person] += await self._rank_one(person, sum(asked.values()))
            asked[person] += 1
            if self._wishes.value.pace_s:
                await pause(self, self._wishes.value.pace_s)
        if before < wanted:
            self.get_logger().info(f"gave {wanted - before} rankings")
        self.heartbeat.report("waiting", f"done: {wanted} of {wanted} rankings")

    async def _count(self, person: Person, effective: bool = True) -> int:
        """Rankings of a person that count, or all answers."""
        if not effective:
            request = ListRankings.Request(annotator=person.name, limit=1)
            return int((await call(self, self._list, request)).total)
        found = await call(self, self._progress, GetProgress.Request(annotator=person.name))
        return sum(int(row.ranked) for row in found.annotators)

    async def _strategy_is_ready(self) -> None:
        """Wait while the preference node would ask uniformly only because it is not ready."""
        while True:
            progress = await call(self, self._progress, GetProgress.Request(annotator="nobody"))
            if "features are read" not in progress.strategy_detail:
                return
            self.heartbeat.report("waiting", f"{progress.strategy}: {progress.strategy_detail}")
            await pause(self, RETRY_S)

    async def _rank_one(self, person: Person, number: int) -> int:
        """Answer one query; returns how many rankings that makes: none if it is skipped."""
        asked = await call(self, self._get_query, GetQuery.Request(annotator=person.name))
        if not asked.success:
            raise RaplError(asked.message)
        began_s, shown_ns = time.monotonic(), time.time_ns()
        answer = self._answer(asked.query, person, number)
        ranking = Ranking(
            ranking_id=uuid.uuid4().hex,
            annotator=person.name,
            episode_ids=tuple(asked.query.episode_ids),
            ranks=answer.ranks,
            verdict=answer.verdict,
            query_id=asked.query.query_id,
            response_s=time.monotonic() - began_s,
            created_ns=time.time_ns(),
            shown_ns=shown_ns,
            source=topics.SIMULATED_HUMAN,
        )
        request = SubmitRanking.Request(ranking=conversions.ranking_to_ros(ranking))
        stored = await call(self, self._submit, request)
        if not stored.success:
            raise RaplError(stored.message)
        return int(answer.verdict == "ranked")

    def _answer(self, query: Query, person: Person, number: int) -> Answer:
        human = SimulatedHuman(
            np.random.default_rng([self._wishes.value.seed, number]), self._wishes.value
        )
        returns = [self._return_of(episode_id, person, human) for episode_id in query.episode_ids]
        return human.answer(returns)

    def _return_of(self, episode_id: str, person: Person, human: SimulatedHuman) -> float:
        key = episode_id, person.wish
        if key not in self._returns:
            if person.wish == "task" and human.knobs.myopia == 1.0:
                known = self._episodes.summary(episode_id).human_return
                self._returns[key] = math.nan if known is None else known
            else:  # the states are needed: some tens of milliseconds, once a video
                episode = self._episodes.load(episode_id)
                names = get_task(episode.task).state_names
                rewards = wish_rewards(person.wish, episode.human_rewards, episode.states, names)
                self._returns[key] = human.utility(rewards[1:])
        return self._returns[key]

    def _on_episode(self, msg: EpisodeInfo) -> None:
        if self._wishes.value.myopia == 1.0:
            returned = msg.human_return if msg.has_truth else math.nan
            self._returns[msg.episode_id, "task"] = returned


if __name__ == "__main__":
    main(SimulatedHumanNode)
