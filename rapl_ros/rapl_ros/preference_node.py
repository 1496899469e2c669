"""The node ``preference``: whom to ask about what, the answers, and what is learnt from them."""

import time
import traceback
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rapl_msgs.action import Align
from rapl_msgs.msg import EpisodeInfo
from rapl_msgs.srv import GetProgress, GetQuery, ListRankings, SubmitRanking, Undo
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from std_msgs.msg import String

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RankingError, RaplError, UnknownNameError
from rapl_core.preferences import (
    Query,
    QueryDesk,
    QueryRequest,
    QuerySelector,
    RankingStore,
    expert_set,
)
from rapl_core.preferences.agreement import AgreementTable, agreement_table
from rapl_core.preferences.own_videos import OWN, OWN_VIDEOS_FILE, OwnQueries, OwnVideos
from rapl_core.preferences.people import PeopleConfig
from rapl_core.preferences.progress import RankingProgress, measure_progress, needed
from rapl_core.preferences.store import RANKINGS_FILE
from rapl_core.preferences.strategies import STRATEGIES
from rapl_core.types import Noise
from rapl_ros import conversions, qos, topics
from rapl_ros.background import Worker
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import ConfigParameters
from rapl_ros.preference_config import PreferenceConfig
from rapl_ros.progress import count_words
from rapl_ros.strategist import Strategist

LIST_LIMIT = 100
AGREEMENT_KEPT_S = 2.0
"""For so long agreement may be that of before the newest answers."""
OWN_STREAM = 403
"""Of the seed, for queries about the learner's own videos."""
AGREEMENT_SHARE = 0.05
"""Of this node's time that measuring it takes at most: 10,000 rankings take a second."""
WRITABLE = (
    "rankings_wanted", "strategy", "repeat_share", "shared_share",
    "noise", "smoothing_rate", "groups",
)  # fmt: skip


class AlignmentCancelledError(RaplError):
    """Somebody asked for an end."""


class PreferenceNode(RaplNode):
    """Hands out queries, stores rankings, trains encoders.

    Subscribes ``episode`` (rapl_msgs/EpisodeInfo) and ``unreadable_episode`` (std_msgs/String, an
    id). Serves ``~/get_query`` (rapl_msgs/GetQuery),
    ``~/submit_ranking`` (rapl_msgs/SubmitRanking), ``~/undo`` (rapl_msgs/Undo),
    ``~/list_rankings`` (rapl_msgs/ListRankings), ``~/get_progress`` (rapl_msgs/GetProgress) and
    ``~/align`` (rapl_msgs/Align), one goal at a time.

    A submitted ranking is answered with success only when it is on disk; that write is the one
    thing here that may take some milliseconds of a callback.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.PREFERENCE, **options)
        self._settings = ConfigParameters(self, PreferenceConfig(), writable=WRITABLE)
        folder = self.config.run_folder
        self._episodes = EpisodeStore(folder / "episodes")
        self._store = RankingStore(folder / RANKINGS_FILE, self._episodes.__contains__)
        self._pool: set[str] = set()
        self._own = OwnVideos(folder / OWN_VIDEOS_FILE)
        self._expert_ids: list[str] | None = None
        for known in self._episodes.summaries():
            self._take_in(known.episode_id, known.purpose, known.last_stamp_ns)
        self._strategist = Strategist(
            self._store,
            folder,
            lambda: self._pool.copy(),
            self.config.preset,
            self.config.precision,
            self.config.seed,
            self.config.backbone,
            Path(self.config.weights) if self.config.weights else None,
        )
        self._agreement: tuple[int, float, AgreementTable] | None = None
        self._unreadable: set[str] = set()
        self._telling = self.steady_timer(0.0, self._after_answering)
        self._telling.cancel()
        self._worker: Worker | None = None
        self._aligning = False
        self.subscribe_to(EpisodeInfo, topics.EPISODE, self._on_episode, qos.event())
        self.subscribe_to(String, topics.UNREADABLE_EPISODE, self._on_unreadable, qos.event())
        self.create_service(GetQuery, topics.GET_QUERY, self._on_get_query)
        self.create_service(SubmitRanking, topics.SUBMIT_RANKING, self._on_submit)
        self.create_service(Undo, topics.UNDO, self._on_undo)
        self.create_service(ListRankings, topics.LIST_RANKINGS, self._on_list)
        self.create_service(GetProgress, topics.GET_PROGRESS, self._on_progress)
        self._align_server = ActionServer(
            self,
            Align,
            topics.ALIGN,
            self._align,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._tell()

    @property
    def config(self) -> PreferenceConfig:
        """The parameters as they stand."""
        return self._settings.value

    def close(self) -> None:
        """Close the store; an alignment under way leaves nothing behind."""
        if self._worker is not None:
            self._worker.close(0.5)
        self._strategist.close(0.5)
        self._store.close()

    # Queries and rankings

    def _on_episode(self, msg: EpisodeInfo) -> None:
        self._take_in(msg.episode_id, msg.purpose, conversions.time_from_ros(msg.header.stamp))
        if msg.purpose in self.config.purposes:
            self._tell()

    def _on_unreadable(self, msg: String) -> None:
        """Somebody could not show a video: look, and ask about it no more if that is so."""
        if msg.data not in self._pool and msg.data not in self._own:
            return
        try:
            self._episodes.frames(msg.data)
        except (RaplError, OSError) as error:
            self._take_out({msg.data}, str(error))

    def _take_out(self, episode_ids: set[str], reason: str) -> None:
        self._pool -= episode_ids
        for episode_id in episode_ids:
            self._own.discard(episode_id)
        self._unreadable |= episode_ids
        names = ", ".join(sorted(self._unreadable))
        self.diagnostics.warn("unreadable videos", f"asked about no more: {names} ({reason})")

    def _forget_missing(self) -> bool:
        """Take videos whose files are gone out of the pool; return whether there were any."""
        gone = {video for video in self._pool.union(self._own) if video not in self._episodes}
        if gone:
            self._take_out(gone, "their files are gone")
        return bool(gone)

    def _take_in(self, episode_id: str, purpose: str, stamp_ns: int) -> None:
        """A video is on disk."""
        if purpose in self.config.purposes:
            self._pool.add(episode_id)
        elif purpose == self.config.own_purpose:
            self._own.add(episode_id, stamp_ns)

    def _on_get_query(
        self, request: GetQuery.Request, response: GetQuery.Response
    ) -> GetQuery.Response:
        try:
            strategy = request.strategy or self.config.strategy
            if strategy not in (*STRATEGIES, OWN):
                raise UnknownNameError("query strategy", strategy, (*STRATEGIES, OWN))
            wish = conversions.query_request_from_ros(request)
            query = self._next_query(wish, strategy)
        except RaplError as error:
            response.message = str(error)
            return response
        response.success, response.query = True, conversions.query_to_ros(query)
        return response

    def _next_query(self, wish: QueryRequest, strategy: str) -> Query:
        try:
            return self._ask_next(wish, strategy)
        except RankingError:
            if not self._forget_missing():
                raise
        return self._ask_next(wish, strategy)

    def _ask_next(self, wish: QueryRequest, strategy: str) -> Query:
        desk, selector = QueryDesk(self._store, self.config), self._selector(strategy, wish.size)
        # Of what was begun before, only what is about the learner's new videos helps it now.
        about = self._own.new(most=None) if strategy == OWN else None
        return desk.next(wish, self._asked_about(strategy), selector, about)

    def _asked_about(self, strategy: str) -> set[str]:
        return self._pool.union(self._own) if strategy == OWN else self._pool

    def _own_queries(self, size: int) -> QuerySelector:
        """Queries about the learner's new videos; the expert set is that of the last alignment."""
        with self._store.reading() as ledger:
            asked, rankings = ledger.queries, list(ledger.effective())
        if self._expert_ids is None:
            ranked = {name for ranking in rankings if ranking.ranks for name in ranking.episode_ids}
            fewer = min(self.config.experts, len(ranked))
            self._expert_ids = expert_set(rankings, fewer) if ranked else []
        # The number of queries before is part of the seed: a restart goes on, not back.
        rng = np.random.default_rng([self.config.seed, OWN_STREAM, asked])
        return OwnQueries(rng, self._own.new(), self._expert_ids, size)

    def _on_submit(
        self, request: SubmitRanking.Request, response: SubmitRanking.Response
    ) -> SubmitRanking.Response:
        try:
            ranking = conversions.ranking_from_ros(request.ranking)
            response.rankings = self._store.add(ranking)
            response.given, response.needed = self._given_and_needed()
        except RaplError as error:
            self.diagnostics.count("refused_rankings")
            self.get_logger().warning(f"ranking refused: {error}")
            response.message = str(error)
            return response
        response.success = True
        self._telling.reset()
        return response

    def _on_undo(self, request: Undo.Request, response: Undo.Response) -> Undo.Response:
        try:
            undone = self._store.undo(
                request.annotator, request.withdrawal_id, request.ranking_id, self.config.lease_s
            )
            response.given, response.needed = self._given_and_needed()
        except RaplError as error:
            self.diagnostics.count("refused_rankings")
            response.message = str(error)
            return response
        response.success, response.ranking = True, conversions.ranking_to_ros(undone.ranking)
        if undone.query is not None:
            response.query = conversions.query_to_ros(undone.query)
        self._telling.reset()
        return response

    def _on_list(
        self, request: ListRankings.Request, response: ListRankings.Response
    ) -> ListRankings.Response:
        annotator = request.annotator or None
        try:
            limit = request.limit or LIST_LIMIT
            if request.effective:
                found = self._store.effective(annotator)
                rankings = found[request.offset : request.offset + limit]
                response.total = len(found)
            else:
                rankings = self._store.all(annotator, request.offset, limit)
                response.total = self._store.count(annotator)
        except RaplError as error:
            response.message = str(error)
            return response
        response.rankings = [conversions.ranking_to_ros(ranking) for ranking in rankings]
        response.success = True
        return response

    def _on_progress(
        self, request: GetProgress.Request, response: GetProgress.Response
    ) -> GetProgress.Response:
        try:
            progress = self._progress()
        except RaplError as error:
            response.message = str(error)
            return response
        response.videos = len(self._pool)
        response.strategy = self.config.strategy
        self._selector(self.config.strategy)  # begins to learn
        response.strategy_detail = self._strategist.detail(self.config.strategy)
        conversions.fill_progress(response, progress, request.annotator)
        response.success = True
        return response

    def _selector(self, strategy: str, size: int = 0) -> QuerySelector | None:
        size = size or self.config.query_size
        if strategy == OWN:
            return self._own_queries(size)
        return self._strategist.selector(strategy, size, self.config.rankings_wanted)

    def _progress(self) -> RankingProgress:
        """Agreement is over all pairs of all rankings: measured anew only after an answer, and not
        for each of many."""
        with self._store.reading() as ledger:
            rows, began_s = len(ledger.rankings), time.monotonic()
            held = self._agreement
            if held is None or (held[0] != rows and began_s > held[1]):
                table = agreement_table(ledger.effective())
                took_s = time.monotonic() - began_s
                due_s = began_s + max(AGREEMENT_KEPT_S, took_s / AGREEMENT_SHARE)
                self._agreement = held = rows, due_s, table
            wanted = self.config.rankings_wanted
            return measure_progress(ledger, wanted, time.time_ns(), held[2])

    def _given_and_needed(self) -> tuple[int, int]:
        with self._store.reading() as ledger:
            given = ledger.given()
        return given, needed(self.config.rankings_wanted, given)

    def _after_answering(self) -> None:
        """Once the answer is sent: nobody waits for this."""
        self._telling.cancel()
        self._tell()

    def _tell(self) -> None:
        self._strategist.notice()
        if not self._aligning:
            given, missing = self._given_and_needed()
            what = f"{len(self._pool)} videos, {given} rankings"
            self.heartbeat.report("active", f"{what}, {missing} needed" if missing else what)

    # Alignment

    def _on_goal(self, _: Align.Goal) -> GoalResponse:
        return GoalResponse.REJECT if self._aligning else GoalResponse.ACCEPT

    async def _align(self, goal: ServerGoalHandle) -> Align.Result:
        self._aligning = True
        if self._worker is None:
            self._worker = Worker(self, "alignment", capacity=1)
        result = Align.Result(held_out_accuracy=float("nan"), mistakes=float("nan"))
        began_s, newest_ns = time.monotonic(), self._own.newest_ns
        try:
            outcome = await self._worker.submit(lambda: self._work(goal))
            conversions.fill_align_result(result, outcome)
            result.message = f"{result.uri} in {time.monotonic() - began_s:.1f} s"
            self.get_logger().info(outcome.findings)
            self._own.aligned(newest_ns)
            self._expert_ids = None
            result.success = True
            goal.succeed()
        except AlignmentCancelledError as error:
            result.message = str(error)
            goal.canceled()
        except Exception as error:
            known = isinstance(error, RaplError | OSError)
            result.message = str(error) if known else f"{type(error).__name__}: {error}"
            told = error if known else "".join(traceback.format_exception(error))
            self.get_logger().error(f"alignment failed: {told}")
            goal.abort()
        finally:
            self._aligning = False
            self._tell()
        return result

    def _work(self, goal: ServerGoalHandle) -> Any:
        """Train, on the worker's thread."""
        import torch  # here, for it takes seconds and 250 MiB, and asking people needs none of it

        from rapl_core.representations.alignment_job import AlignmentOrder, run_alignment
        from rapl_core.representations.masked import MaskedConfig
        from rapl_core.representations.tcc import TccConfig

        torch.set_num_threads(self.config.threads)
        config, request = self.config, goal.request
        if request.noise and request.noise not in get_args(Noise):
            raise UnknownNameError("treatment of noise", request.noise, get_args(Noise))
        people = PeopleConfig(
            noise=request.noise or config.noise,
            smoothing_rate=config.smoothing_rate,
            groups=int(request.groups) or config.groups,
        )
        order = AlignmentOrder(
            run_folder=config.run_folder,
            method=request.encoder,
            preset=request.preset,
            rankings=request.triplets,
            seed=request.seed,
            experts=config.experts,
            precision=config.precision,
            purposes=config.purposes,
            people=people,
            backbone=config.backbone,
            weights=Path(config.weights) if config.weights else None,
            engine=config.engine,
            trained=config.trained,
            tcc=TccConfig(iterations=config.tcc_iterations, trained=config.trained),
            masked=MaskedConfig(iterations=config.masked_iterations),
        )

        def on_video(done: int, total: int) -> None:
            _stop_if_cancelled(goal)
            self.heartbeat.report("active", count_words("reads features", done, total, "videos"))

        def on_epoch(progress: Any) -> None:
            _stop_if_cancelled(goal)
            goal.publish_feedback(conversions.align_feedback_to_ros(progress))

        return run_alignment(order, on_video, on_epoch)


def _stop_if_cancelled(goal: ServerGoalHandle) -> None:
    if goal.is_cancel_requested:
        raise AlignmentCancelledError("cancelled")


if __name__ == "__main__":
    main(PreferenceNode)
