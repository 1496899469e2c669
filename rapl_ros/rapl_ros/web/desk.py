"""Hands queries to people and takes their answers: blinded, leased, sent once."""

import asyncio
import secrets
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Generic, TypeVar
from weakref import WeakValueDictionary

from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.preferences import Query
from rapl_core.types import Ranking
from rapl_ros.web.ports import PreferencePort
from rapl_ros.web.problems import RefusedError, bad_request, conflict, unavailable
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
"""Queries, answers and videos. An answer to an older query is refused, and the page asks anew."""
PASSED_OVER = 5
"""Queries about videos that cannot be read that are passed over before the person is told."""
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
class _Given:
    """On which page a query stands that waits for its answer."""

    annotator: str
    page: str
    expires_ns: int


@dataclass(frozen=True)
class _Sent:
    """An answer and what was made of it; an answer that is repeated must be the same."""

    content: dict[str, Any]
    ranking: Ranking


class QueryDesk:
    """Between the page and the preference node.

    Videos are known to the page by random keys only, and stand in the order that the preference
    node has drawn for the query: nothing tells the person which is which. Two pages of one name,
    tabs or people, are not given the same and do not take back each other's answers.
    """

    def __init__(self, port: PreferencePort, sheets: SheetCache) -> None:
        self._port, self._sheets = port, sheets
        self._loans: _Memory[_Loan] = _Memory(REMEMBERED)
        self._sent: _Memory[_Sent] = _Memory(REMEMBERED)
        self._keys: _Memory[str] = _Memory(REMEMBERED)
        self._episodes: _Memory[str] = _Memory(REMEMBERED)
        self._unreadable: set[str] = set()
        self._given: OrderedDict[str, _Given] = OrderedDict()
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def next(self, request: QueryRequest) -> ShownQuery:
        """Return a query that the page does not hold: one begun earlier, else a new one.

        :raises RefusedError: ``video_missing`` if only such are asked whose videos cannot be read,
            besides what the preference node says.
        """
        name = request.annotator
        async with self._turns.setdefault(name, asyncio.Lock()):
            held = [*request.held, *self._on_other_pages(name, request.page)]
            for left in reversed(range(PASSED_OVER)):
                query = await self._port.get_query(name, held)
                try:
                    return self._show(query, name, request.page, query.episode_ids)
                except RefusedError:
                    if not left:
                        raise
                    held.append(query.query_id)
            raise AssertionError("PASSED_OVER is not 0")

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
        standing = await self._port.submit(sent.ranking)
        self._given.pop(request.query_id, None)
        return standing

    async def undo(self, request: UndoRequest) -> Undone:
        """Take back an answer; its query may be answered anew."""
        name, wanted = request.annotator, request.ranking_id
        if not wanted and self._on_other_pages(name, request.page):
            text = f"nothing was answered here, and {name} is at work on another page too"
            raise conflict("nothing_to_undo", text)
        undone = await self._port.undo(name, request.withdrawal_id, wanted)
        ranking = undone.ranking
        if ranking.verdict == "withdrawn" or undone.query is None:
            raise conflict("nothing_to_undo", "there is no answer to a query to take back")
        shown = self._show(undone.query, name, request.page, ranking.episode_ids)
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

    def report_unreadable(self, episode_id: str, error: Exception) -> RefusedError:
        """Note that a video cannot be shown, tell the graph once, and return what to answer."""
        if episode_id not in self._unreadable:
            self._unreadable.add(episode_id)
            self._port.report_unreadable(episode_id, str(error))
        return unavailable("video_missing", f"a video cannot be read: {error}")

    def _show(self, query: Query, annotator: str, page: str, order: tuple[str, ...]) -> ShownQuery:
        videos = [self._video(episode_id) for episode_id in order]
        self._loans.put(query.query_id, _Loan(annotator, order))
        self._given[query.query_id] = _Given(annotator, page, query.expires_ns)
        while len(self._given) > REMEMBERED:
            self._given.popitem(last=False)
        return ShownQuery(
            query_id=query.query_id,
            videos=videos,
            expires_in_s=max(0.0, (query.expires_ns - time.time_ns()) / 1e9),
        )

    def _on_other_pages(self, annotator: str, page: str) -> list[str]:
        """Queries that wait for an answer on another page of the same name."""
        now_ns = time.time_ns()
        return [
            query_id
            for query_id, given in self._given.items()
            if given.annotator == annotator
            and given.expires_ns > now_ns
            and page
            and given.page not in ("", page)
        ]

    def _video(self, episode_id: str) -> Video:
        key = self._keys.put(episode_id, secrets.token_hex(16))
        self._episodes.put(key, episode_id)
        try:
            if episode_id in self._unreadable:
                raise CorruptFileError(f"episode {episode_id} could not be read before")
            layout = self._sheets.layout(episode_id)
        except (RaplError, OSError) as error:
            raise self.report_unreadable(episode_id, error) from error
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
            replaces=request.replaces,
            created_ns=now_ns,
            shown_ns=now_ns - round(request.response_s * 1e9),
            source=SOURCE,
        )
    except RaplError as error:
        raise bad_request("bad_ranking", str(error)) from error
