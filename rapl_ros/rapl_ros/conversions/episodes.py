"""Episodes and rankings of them."""

from rapl_msgs import msg as wire_msg

from rapl_core.errors import RankingError
from rapl_core.preferences import Query
from rapl_core.types import (
    Ranking,
    Verdict,
)
from rapl_ros.conversions.headers import (
    counts_to_ros,
    header_to_ros,
    key_from_ros,
    time_from_ros,
    time_to_ros,
)
from rapl_ros.wire import (
    EpisodeRecord,
)


def episode_record_to_ros(record: EpisodeRecord) -> wire_msg.EpisodeInfo:
    """EpisodeRecord to EpisodeInfo."""
    has_truth = record.human_return is not None
    return wire_msg.EpisodeInfo(
        header=header_to_ros(record.key),
        episode_id=record.episode_id,
        task=record.task,
        world=int(record.world),
        purpose=record.purpose,
        controller=record.controller,
        behaviour=record.behaviour,
        steps=int(record.steps),
        uri=record.uri,
        has_truth=has_truth,
        human_return=0.0 if record.human_return is None else float(record.human_return),
        success=bool(record.success) if has_truth else False,
    )


def episode_record_from_ros(msg: wire_msg.EpisodeInfo) -> EpisodeRecord:
    """EpisodeInfo to EpisodeRecord."""
    return EpisodeRecord(
        key=key_from_ros(msg.header),
        episode_id=msg.episode_id,
        task=msg.task,
        world=msg.world,
        purpose=msg.purpose,
        controller=msg.controller,
        behaviour=msg.behaviour,
        steps=msg.steps,
        uri=msg.uri,
        human_return=msg.human_return if msg.has_truth else None,
        success=msg.success if msg.has_truth else None,
    )


def query_to_ros(query: Query) -> wire_msg.Query:
    """Query to its message."""
    return wire_msg.Query(
        query_id=query.query_id,
        episode_ids=list(query.episode_ids),
        strategy=query.strategy,
        expires=time_to_ros(query.expires_ns),
        annotator=query.annotator,
        purpose=query.purpose,
    )


VERDICTS: dict[int, Verdict] = {
    wire_msg.Ranking.RANKED: "ranked",
    wire_msg.Ranking.UNDECIDED: "undecided",
    wire_msg.Ranking.SKIPPED: "skipped",
    wire_msg.Ranking.WITHDRAWN: "withdrawn",
}


def ranking_to_ros(ranking: Ranking) -> wire_msg.Ranking:
    """Ranking to its message."""
    return wire_msg.Ranking(
        ranking_id=ranking.ranking_id,
        query_id=ranking.query_id,
        annotator=ranking.annotator,
        verdict={text: number for number, text in VERDICTS.items()}[ranking.verdict],
        episode_ids=list(ranking.episode_ids),
        ranks=counts_to_ros(ranking.ranks),
        response_s=float(ranking.response_s),
        created=time_to_ros(ranking.created_ns),
        replaces=ranking.replaces,
        shown=time_to_ros(ranking.shown_ns),
        source=ranking.source,
    )


def ranking_from_ros(msg: wire_msg.Ranking) -> Ranking:
    """Message to Ranking.

    :raises RankingError: if it is not acceptable: unknown verdict, repeated episodes, wrong ranks.
    """
    if msg.verdict not in VERDICTS:
        known = ", ".join(f"{number} = {text}" for number, text in VERDICTS.items())
        raise RankingError(f"ranking {msg.ranking_id} has verdict {msg.verdict}; known: {known}")
    return Ranking(
        ranking_id=msg.ranking_id,
        annotator=msg.annotator,
        episode_ids=tuple(msg.episode_ids),
        ranks=tuple(int(rank) for rank in msg.ranks),
        verdict=VERDICTS[msg.verdict],
        query_id=msg.query_id,
        response_s=msg.response_s,
        created_ns=time_from_ros(msg.created),
        replaces=msg.replaces,
        shown_ns=time_from_ros(msg.shown),
        source=msg.source,
    )
