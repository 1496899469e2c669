"""What the page needs of the graph, as seams; the node ``web`` implements them on ROS."""

from dataclasses import dataclass
from typing import Protocol

from rapl_core.preferences import Query
from rapl_core.types import Ranking
from rapl_ros.web.schemas import Progress, Standing


@dataclass(frozen=True)
class TakenBack:
    """An answer that no longer counts."""

    ranking: Ranking
    query: Query | None
    """On loan again; None where nobody had asked for the ranking."""
    standing: Standing


class PreferencePort(Protocol):
    """The services of the preference node. All raise RefusedError."""

    async def get_query(self, annotator: str, held: list[str]) -> Query:
        """Lease a query that the page does not hold; one begun earlier comes first."""
        ...

    async def submit(self, ranking: Ranking) -> Standing:
        """Store a ranking; returns when it is on disk."""
        ...

    async def undo(self, annotator: str, withdrawal_id: str, ranking_id: str) -> TakenBack:
        """Take back a ranking; empty: the annotator's newest answer."""
        ...

    async def progress(self) -> Progress:
        """How far the rankings are, and who gave them."""
        ...

    def report_unreadable(self, episode_id: str, reason: str) -> None:
        """Tell that a video cannot be shown; may be called from any thread."""
        ...


class SystemPort(Protocol):
    """The rest of the graph. All raise RefusedError."""

    async def align(self) -> str:
        """Begin an alignment; returns as soon as it is under way, with what it is."""
        ...

    async def swap(self, encoder: str) -> str:
        """Begin to put an encoder to work; returns as soon as it is asked for."""
        ...

    async def picture(self) -> bytes | None:
        """The camera's newest picture as JPEG; None while there is none."""
        ...
