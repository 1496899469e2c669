"""Rankings: their store, what is made of them, and whom to ask about what."""

from rapl_core.preferences.contest import ContestQueries
from rapl_core.preferences.exchange import export_jsonl, export_queries, read_jsonl
from rapl_core.preferences.expert_set import expert_set, strengths
from rapl_core.preferences.queries import QuerySelector, UniformQueries
from rapl_core.preferences.query import Query
from rapl_core.preferences.query_desk import DeskConfig, QueryDesk, QueryRequest
from rapl_core.preferences.simulated_human import Answer, HumanKnobs, SimulatedHuman
from rapl_core.preferences.store import RankingStore
from rapl_core.preferences.triplets import (
    Pair,
    RankingSplit,
    pairs_from,
    split_rankings,
    triplets_from,
)

__all__ = [
    "Answer",
    "ContestQueries",
    "DeskConfig",
    "HumanKnobs",
    "Pair",
    "Query",
    "QueryDesk",
    "QueryRequest",
    "QuerySelector",
    "RankingSplit",
    "RankingStore",
    "SimulatedHuman",
    "UniformQueries",
    "expert_set",
    "export_jsonl",
    "export_queries",
    "pairs_from",
    "read_jsonl",
    "split_rankings",
    "strengths",
    "triplets_from",
]
