"""A query: the videos that one annotator has been asked to rank."""

from dataclasses import dataclass
from typing import Literal, get_args

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.types import check_episode_id

QueryPurpose = Literal["new", "repeat", "shared"]


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
    """Wall clock; after it others may be asked the same; a late answer counts unless they were."""
    purpose: QueryPurpose = "new"
    """``repeat``: the same person once more, for consistency; ``shared``: what another person has
    answered, for agreement."""

    def __post_init__(self) -> None:
        for episode_id in self.episode_ids:
            check_episode_id(episode_id)
        if len(set(self.episode_ids)) != len(self.episode_ids) or len(self.episode_ids) < 2:
            raise RankingError(
                f"query {self.query_id} needs two or more different videos, got {self.episode_ids}"
            )
        if self.purpose not in get_args(QueryPurpose):
            raise UnknownNameError("purpose of a query", self.purpose, get_args(QueryPurpose))
        if len(self.annotator) > 64:
            raise RankingError(f"query {self.query_id}: annotator has more than 64 characters")
