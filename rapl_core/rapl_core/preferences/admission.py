"""Which rankings a store takes: the rules, each refusal with its reason."""

from collections.abc import Callable, Sequence

from rapl_core.errors import RankingError
from rapl_core.preferences.ledger import Ledger
from rapl_core.types import Ranking


def check_known(
    episode_ids: Sequence[str], known_episode: Callable[[str], bool] | None, what: str
) -> None:
    """
    :param known_episode: tells whether a video exists; None: all do.
    :raises RankingError: naming the unknown ones.
    """
    if known_episode is None:
        return
    unknown = [e for e in episode_ids if not known_episode(e)]
    if unknown:
        raise RankingError(f"{what} names unknown episodes: {', '.join(unknown)}")


def check_correction(ranking: Ranking, ledger: Ledger) -> None:
    """Refuse a correction of nothing, of another person's, of other videos or of an old version.

    :raises RankingError: with the reason.
    """
    if not ranking.replaces:
        return
    what = f"ranking {ranking.ranking_id}"
    held = ledger.ranking(ranking.replaces)
    if held is None:
        raise RankingError(f"{what} replaces {ranking.replaces}, which is not stored")
    if held.annotator != ranking.annotator:
        raise RankingError(
            f"{what} of {ranking.annotator!r} replaces {ranking.replaces}, "
            f"which is of {held.annotator!r}"
        )
    if set(held.episode_ids) != set(ranking.episode_ids):
        raise RankingError(
            f"{what} is about {', '.join(ranking.episode_ids)}, the one that it replaces about "
            f"{', '.join(held.episode_ids)}"
        )
    later = ledger.replaced_by(ranking.replaces)
    if later is not None:
        raise RankingError(
            f"{what} replaces {ranking.replaces}, which {later} has replaced already"
        )


def check_answer(ranking: Ranking, ledger: Ledger, now_ns: int) -> None:
    """Refuse an answer to a query that is unknown, another's, answered or of other videos.

    A lease keeps others from being asked the same, so an answer after it is taken too, unless the
    same has been asked again in the meantime.

    :raises RankingError: with the reason.
    """
    if not ranking.query_id:
        return
    query = ledger.query(ranking.query_id)
    what = f"ranking {ranking.ranking_id}"
    if set(query.episode_ids) != set(ranking.episode_ids):
        raise RankingError(
            f"{what} is about {', '.join(ranking.episode_ids)}, "
            f"its query {query.query_id} about {', '.join(query.episode_ids)}"
        )
    if query.annotator != ranking.annotator:
        raise RankingError(
            f"{what} is of {ranking.annotator!r}, its query {query.query_id} was leased to "
            f"{query.annotator!r}"
        )
    answer = ledger.answer_to(query.query_id)
    if answer is not None and answer.ranking_id == ranking.replaces:
        return
    if answer is not None:
        raise RankingError(
            f"query {query.query_id} is answered already, by ranking {answer.ranking_id}; a "
            "correction names it in 'replaces'"
        )
    late_s = (now_ns - query.expires_ns) / 1e9
    again = ledger.asked_again(query, now_ns) if late_s > 0 else None
    if again is not None:
        raise RankingError(
            f"query {query.query_id} expired {late_s:.0f} s ago, and its videos were asked again "
            f"in query {again.query_id}"
        )
