"""The node ``preference``: whom to ask about what, the answers, and what is learnt from them."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rapl_msgs.action import Align
from rapl_msgs.msg import EpisodeInfo, Query
from rapl_msgs.srv import GetQuery, ListRankings, SubmitRanking
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.preferences import QuerySelector, RankingStore, UniformQueries
from rapl_ros import conversions, qos, topics
from rapl_ros.background import Worker
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config

LIST_LIMIT = 100
STRATEGIES: dict[str, Callable[[np.random.Generator, int], QuerySelector]] = {
    "uniform": UniformQueries
}


class AlignmentCancelledError(RaplError):
    """Somebody asked for an end."""


@dataclass(frozen=True)
class PreferenceConfig:
    """Parameters of the preference node."""

    run_folder: Path = Path(".")
    """Run folder: episodes/, rankings.sqlite, encoders/."""
    strategy: Literal["uniform"] = "uniform"
    """Which videos to ask about next."""
    query_size: int = field(default=3, metadata={"minimum": 2, "maximum": 10})
    """Videos in a query."""
    lease_s: float = field(default=600.0, metadata={"minimum": 1.0, "maximum": 86400.0})
    """Wall time in which a query must be answered."""
    seed: int = field(default=0, metadata={"minimum": 0})
    """The order of queries follows from it."""
    purposes: tuple[str, ...] = ("demonstrate",)
    """Purposes of the episodes that are the pool of videos."""
    experts: int = field(default=10, metadata={"minimum": 1, "maximum": 1000})
    """Videos in the expert set, the most preferred by the rankings alone."""
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    """Of the features that alignment reads. bfloat16 is about three times as fast; what the robot
    is rewarded with is always embedded in float32."""
    threads: int = field(default=1, metadata={"minimum": 1, "maximum": 64})
    """Threads of torch."""


class PreferenceNode(RaplNode):
    """Hands out queries, stores rankings, trains encoders.

    Subscribes ``episode`` (rapl_msgs/EpisodeInfo). Serves ``~/get_query`` (rapl_msgs/GetQuery),
    ``~/submit_ranking`` (rapl_msgs/SubmitRanking), ``~/list_rankings`` (rapl_msgs/ListRankings) and
    ``~/align`` (rapl_msgs/Align), one goal at a time.

    A submitted ranking is answered with success only when it is on disk; that write is the one
    thing here that may take some milliseconds of a callback.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.PREFERENCE, **options)
        self.config = declare_config(self, PreferenceConfig())
        folder = self.config.run_folder
        self._episodes = EpisodeStore(folder / "episodes")
        self._store = RankingStore(folder / "rankings.sqlite", self._episodes.__contains__)
        self._pool = {
            summary.episode_id
            for summary in self._episodes.summaries()
            if summary.purpose in self.config.purposes
        }
        self._worker: Worker | None = None
        self._aligning = False
        self.subscribe_to(EpisodeInfo, topics.EPISODE, self._on_episode, qos.event())
        self.create_service(GetQuery, topics.GET_QUERY, self._on_get_query)
        self.create_service(SubmitRanking, topics.SUBMIT_RANKING, self._on_submit)
        self.create_service(ListRankings, topics.LIST_RANKINGS, self._on_list)
        self._align_server = ActionServer(
            self,
            Align,
            topics.ALIGN,
            self._align,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._tell()

    def close(self) -> None:
        """Close the store; an alignment under way leaves nothing behind."""
        if self._worker is not None:
            self._worker.close(0.5)
        self._store.close()

    # Queries and rankings

    def _on_episode(self, msg: EpisodeInfo) -> None:
        if msg.purpose in self.config.purposes:
            self._pool.add(msg.episode_id)
            self._tell()

    def _on_get_query(
        self, request: GetQuery.Request, response: GetQuery.Response
    ) -> GetQuery.Response:
        try:
            query = self._next_query(request.annotator, request.strategy or self.config.strategy)
        except RaplError as error:
            response.message = str(error)
            return response
        response.success, response.query = True, query
        return response

    def _next_query(self, annotator: str, strategy: str) -> Query:
        if strategy not in STRATEGIES:
            raise UnknownNameError("query strategy", strategy, STRATEGIES)
        past = [ranking.episode_ids for ranking in self._store.all()]
        past += [query.episode_ids for query in self._store.open_queries()]
        # The number of queries before is part of the seed: a restart goes on, not back.
        rng = np.random.default_rng([self.config.seed, len(past)])
        selector = STRATEGIES[strategy](rng, self.config.query_size)
        episode_ids = selector.next(sorted(self._pool), past)
        query = self._store.lease(episode_ids, annotator, strategy, self.config.lease_s)
        return conversions.query_to_ros(query)

    def _on_submit(
        self, request: SubmitRanking.Request, response: SubmitRanking.Response
    ) -> SubmitRanking.Response:
        try:
            ranking = conversions.ranking_from_ros(request.ranking)
            response.rankings = self._store.add(ranking)
        except RaplError as error:
            self.diagnostics.count("refused_rankings")
            response.message = str(error)
            return response
        response.success = True
        self._tell()
        return response

    def _on_list(
        self, request: ListRankings.Request, response: ListRankings.Response
    ) -> ListRankings.Response:
        annotator = request.annotator or None
        try:
            limit = request.limit or LIST_LIMIT
            rankings = self._store.all(annotator, request.offset, limit)
            response.total = self._store.count(annotator)
        except RaplError as error:
            response.message = str(error)
            return response
        response.rankings = [conversions.ranking_to_ros(ranking) for ranking in rankings]
        response.success = True
        return response

    def _tell(self) -> None:
        if not self._aligning:
            what = f"{len(self._pool)} videos, {self._store.count()} rankings"
            self.heartbeat.report("active", what)

    # Alignment

    def _on_goal(self, _: Align.Goal) -> GoalResponse:
        return GoalResponse.REJECT if self._aligning else GoalResponse.ACCEPT

    async def _align(self, goal: ServerGoalHandle) -> Align.Result:
        self._aligning = True
        if self._worker is None:
            self._worker = Worker(self, "alignment", capacity=1)
        result = Align.Result(held_out_accuracy=float("nan"))
        began_s = time.monotonic()
        try:
            outcome = await self._worker.submit(lambda: self._work(goal))
            result.version, result.uri = outcome.version, outcome.uri
            result.held_out_accuracy = float(outcome.held_out_accuracy)
            result.triplets = int(outcome.triplets)
            result.message = f"{outcome.uri} in {time.monotonic() - began_s:.1f} s"
            result.success = True
            goal.succeed()
        except AlignmentCancelledError as error:
            result.message = str(error)
            goal.canceled()
        except (RaplError, OSError, RuntimeError, ValueError) as error:
            result.message = str(error)
            self.get_logger().error(f"alignment failed: {error}")
            goal.abort()
        finally:
            self._aligning = False
            self._tell()
        return result

    def _work(self, goal: ServerGoalHandle) -> Any:
        """Train, on the worker's thread."""
        import torch  # here, for it takes seconds and 250 MiB, and asking people needs none of it

        from rapl_ros.alignment_job import AlignmentOrder, run_alignment

        torch.set_num_threads(self.config.threads)
        config, request = self.config, goal.request
        order = AlignmentOrder(
            run_folder=config.run_folder,
            method=request.encoder,
            preset=request.preset,
            rankings=request.triplets,
            seed=request.seed,
            experts=config.experts,
            precision=config.precision,
            purposes=config.purposes,
        )

        def on_video(done: int, total: int) -> None:
            _stop_if_cancelled(goal)
            self.heartbeat.report("active", f"reads features: {done} of {total} videos")

        def on_epoch(progress: Any) -> None:
            _stop_if_cancelled(goal)
            goal.publish_feedback(conversions.align_feedback_to_ros(progress))

        return run_alignment(order, on_video, on_epoch)


def _stop_if_cancelled(goal: ServerGoalHandle) -> None:
    if goal.is_cancel_requested:
        raise AlignmentCancelledError("cancelled")


if __name__ == "__main__":
    main(PreferenceNode)
