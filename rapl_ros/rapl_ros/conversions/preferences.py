"""Queries that are asked for, and how the asking gets on."""

from rapl_msgs import msg as wire_msg
from rapl_msgs.srv import GetProgress, GetQuery

from rapl_core.preferences import QueryRequest
from rapl_core.preferences.progress import AnnotatorProgress, RankingProgress
from rapl_ros.conversions.headers import time_to_ros


def query_request_from_ros(msg: GetQuery.Request) -> QueryRequest:
    """Request of GetQuery to QueryRequest.

    :raises RaplError: if it asks for too many videos, or for an unknown purpose.
    """
    return QueryRequest(
        annotator=msg.annotator,
        size=int(msg.size),
        purpose=msg.purpose,
        resume=bool(msg.resume),
        held=frozenset(msg.held),
    )


def annotator_progress_to_ros(progress: AnnotatorProgress) -> wire_msg.AnnotatorProgress:
    """AnnotatorProgress to its message."""
    return wire_msg.AnnotatorProgress(
        annotator=progress.annotator,
        ranked=int(progress.counts.get("ranked", 0)),
        undecided=int(progress.counts.get("undecided", 0)),
        skipped=int(progress.counts.get("skipped", 0)),
        withdrawn=int(progress.counts.get("withdrawn", 0)),
        consistency=float(progress.consistency.value),
        consistency_pairs=int(progress.consistency.pairs),
        agreement=float(progress.agreement.value),
        agreement_pairs=int(progress.agreement.pairs),
        median_response_s=float(progress.median_response_s),
        newest=time_to_ros(progress.newest_ns),
    )


def fill_progress(
    response: GetProgress.Response, progress: RankingProgress, annotator: str = ""
) -> None:
    """Put RankingProgress into the answer of GetProgress.

    :param annotator: only this one among the annotators; empty: all.
    """
    response.wanted = int(progress.wanted)
    response.given = int(progress.given)
    response.needed = int(progress.needed)
    response.open_queries = int(progress.open_queries)
    response.agreement = float(progress.agreement.value)
    response.agreement_pairs = int(progress.agreement.pairs)
    response.annotators = [
        annotator_progress_to_ros(person)
        for person in progress.annotators
        if annotator in ("", person.annotator)
    ]
