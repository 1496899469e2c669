"""What the preference node tells people's page: queries, how far the rankings are.

Imported by name, not through ``rapl_ros.conversions``: it needs pydantic, which no other node does.
"""

import math

from rapl_msgs import msg as wire_msg
from rapl_msgs.srv import GetProgress, SubmitRanking, Undo

from rapl_core.preferences import Query
from rapl_ros.conversions.episodes import ranking_from_ros
from rapl_ros.conversions.headers import time_from_ros
from rapl_ros.web.ports import TakenBack
from rapl_ros.web.schemas import AnnotatorStanding, Progress, Standing


def query_from_ros(msg: wire_msg.Query) -> Query:
    """Message to Query.

    :raises RaplError: if its videos are fewer than two, repeated or no episode ids.
    """
    return Query(
        query_id=msg.query_id,
        episode_ids=tuple(msg.episode_ids),
        annotator=msg.annotator,
        strategy=msg.strategy,
        created_ns=0,
        expires_ns=time_from_ros(msg.expires),
    )


def standing_from_ros(msg: SubmitRanking.Response | Undo.Response) -> Standing:
    """How far the rankings are after an answer; wanted = given + needed unless nothing is."""
    return Standing(given=msg.given, needed=msg.needed, wanted=0)


def taken_back_from_ros(msg: Undo.Response) -> TakenBack:
    """What was taken back.

    :raises RaplError: if ranking or query are not acceptable.
    """
    return TakenBack(
        ranking=ranking_from_ros(msg.ranking),
        query=query_from_ros(msg.query) if msg.query.query_id else None,
        standing=standing_from_ros(msg),
    )


def progress_from_ros(msg: GetProgress.Response) -> Progress:
    """How far the rankings are, and who gave them."""
    return Progress(
        standing=Standing(given=msg.given, wanted=msg.wanted, needed=msg.needed),
        videos=msg.videos,
        agreement=_known(msg.agreement),
        agreement_pairs=msg.agreement_pairs,
        strategy=msg.strategy,
        annotators=[
            AnnotatorStanding(
                annotator=one.annotator,
                ranked=one.ranked,
                undecided=one.undecided,
                skipped=one.skipped,
                consistency=_known(one.consistency),
                consistency_pairs=one.consistency_pairs,
                agreement=_known(one.agreement),
                agreement_pairs=one.agreement_pairs,
                median_response_s=_known(one.median_response_s),
            )
            for one in msg.annotators
        ],
    )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
