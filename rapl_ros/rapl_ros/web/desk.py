"""Hands queries to people and takes their answers: blinded, leased, sent once."""

import secrets
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from rapl_core.errors import RaplError
from rapl_core.preferences import Query
from rapl_core.types import Ranking
from rapl_ros.web.ports import PreferencePort
from rapl_ros.web.problems import bad_request, conflict, unavailable
from rapl_ros.web.schemas import (
    QueryRequest,
    RankingRequest,
    ShownQuery,
    Standing,
    Undone,
    UndoRequest,
    Video,
)
from rapl_ros.web.sprites import SheetCache

REMEMBERED = 4096
"""Queries, answers and videos; older ones are asked of the preference node anew."""
SOURCE = "web"

Value = TypeVar("Value")


class _Memory(Generic[Value]):
    """The newest entries of a dictionary; safe for several threads."""

    def __init__(self, capacity: int) -> None:
        self._capacity, self._lock = capacity, threading.Lock()
        self._entries: OrderedDict[str, Value] = OrderedDict()

    def put(self, key: str, value: Value) -> Value:
        """Keep ``value`` unless there is one already; return the one kept."""
        with self._lock:
            kept = self._entries.setdefault(key, value)
            self._entries.move_to_end(key)
            while len(self._entries) > self._capacity:
                self._entries.popitem(last=False)
            return kept

    def get(self, key: str) -> Value | None:
        """Return what is kept under ``key``."""
        with self._lock:
            return self._entries.get(key)


@dataclass(frozen=True)
class _Loan:
    """A query in somebody's hands."""

    annotator: str
    episode_ids: tuple[str, ...]
    """As shown, left to right."""


@dataclass(frozen=True)
class _Sent:
    """An answer and what was made of it; an answer that is repeated must be the same."""

    content: dict[str, Any]
    ranking: Ranking


class QueryDesk:
    """Between the page and the preference node.

    Videos are known to the page by random keys only, and stand in the order that the preference
    node has drawn for the query: nothing tells the person which is which.
    """

    def __init__(self, port: PreferencePort, sheets: SheetCache) -> None:
        self._port, self._sheets = port, sheets
        self._loans: _Memory[_Loan] = _Memory(REMEMBERED)
        self._sent: _Memory[_Sent] = _Memory(REMEMBERED)
        self._keys: _Memory[str] = _Memory(REMEMBERED)
        self._episodes: _Memory[str] = _Memory(REMEMBERED)

    async def next(self, request: QueryRequest) -> ShownQuery:
        """Return a query that the page does not hold: one begun earlier, else a new one."""
        query = await self._port.get_query(request.annotator, request.held)
        return self._show(query, request.annotator, query.episode_ids)

    async def submit(self, request: RankingRequest) -> Standing:
        """Store an answer.

        :raises RefusedError: if the query is not on loan to this annotator or the answer is not
            acceptable.
        """
        loan = self._loans.get(request.query_id)
        if loan is None or loan.annotator != request.annotator:
            raise conflict(
                "unknown_query", f"query {request.query_id} is not on loan to {request.annotator}"
            )
        expected = len(loan.episode_ids) if request.verdict == "ranked" else 0
        if len(request.ranks) != expected:
            given = len(request.ranks)
            raise bad_request("bad_ranks", f"got {given} ranks, {request.verdict} takes {expected}")
        sent = self._sent.put(request.ranking_id, _Sent(_content(request), _ranking(request, loan)))
        if sent.content != _content(request):
            raise conflict("used_id", f"ranking_id {request.ranking_id} has another content")
        return await self._port.submit(sent.ranking)

    async def undo(self, request: UndoRequest) -> Undone:
        """Take back the annotator's newest answer; its query may be answered anew."""
        undone = await self._port.undo(request.annotator, request.withdrawal_id)
        ranking = undone.ranking
        if ranking.verdict == "withdrawn" or undone.query is None:
            raise conflict("nothing_to_undo", "there is no answer to a query to take back")
        shown = self._show(undone.query, request.annotator, ranking.episode_ids)
        return Undone(
            query=shown,
            verdict=ranking.verdict,
            ranks=list(ranking.ranks),
            standing=undone.standing,
        )

    def episode_of(self, key: str) -> str:
        """Return the episode that a video key stands for.

        :raises KeyError: if there is no such key.
        """
        episode_id = self._episodes.get(key)
        if episode_id is None:
            raise KeyError(key)
        return episode_id

    def _show(self, query: Query, annotator: str, order: tuple[str, ...]) -> ShownQuery:
        self._loans.put(query.query_id, _Loan(annotator, order))
        return ShownQuery(
            query_id=query.query_id,
            videos=[self._video(episode_id) for episode_id in order],
            expires_in_s=max(0.0, (query.expires_ns - time.time_ns()) / 1e9),
        )

    def _video(self, episode_id: str) -> Video:
        key = self._keys.put(episode_id, secrets.token_hex(16))
        self._episodes.put(key, episode_id)
        try:
            layout = self._sheets.layout(episode_id)
        except RaplError as error:
            raise unavailable("video_missing", f"a video cannot be read: {error}") from error
        return Video(
            url=f"/api/videos/{key}.webp",
            frames=layout.frames,
            columns=layout.columns,
            width=layout.width,
            height=layout.height,
            period_s=layout.period_s,
        )


def _content(request: RankingRequest) -> dict[str, Any]:
    """What must be the same when an answer is sent again; the time it took is the first's."""
    return request.model_dump(exclude={"response_s"})


def _ranking(request: RankingRequest, loan: _Loan) -> Ranking:
    now_ns = time.time_ns()
    try:
        return Ranking(
            ranking_id=request.ranking_id,
            annotator=request.annotator,
            episode_ids=loan.episode_ids,
            ranks=tuple(request.ranks),
            verdict=request.verdict,
            query_id=request.query_id,
            response_s=request.response_s,
            created_ns=now_ns,
            shown_ns=now_ns - round(request.response_s * 1e9),
            source=SOURCE,
        )
    except RaplError as error:
        raise bad_request("bad_ranking", str(error)) from error
