"""A query: the videos that one annotator has been asked to rank."""

from dataclasses import dataclass

from rapl_core.errors import RankingError
from rapl_core.types import check_episode_id


@dataclass(frozen=True)
class Query:
    """Videos on loan to one annotator until the lease expires."""

    query_id: str
    episode_ids: tuple[str, ...]
    """In the order in which to show them."""
    annotator: str
    strategy: str
    created_ns: int
    """Wall clock."""
    expires_ns: int
    """Wall clock; an answer after it is refused."""

    def __post_init__(self) -> None:
        for episode_id in self.episode_ids:
            check_episode_id(episode_id)
        if len(set(self.episode_ids)) != len(self.episode_ids) or len(self.episode_ids) < 2:
            raise RankingError(
                f"query {self.query_id} needs two or more different videos, got {self.episode_ids}"
            )
