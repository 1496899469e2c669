"""Rankings for tests of the store."""

from rapl_core.types import Ranking


def ranking(ranking_id: str = "r1", **changes: object) -> Ranking:
    """Ada's answer about three videos, but for ``changes``."""
    fields: dict[str, object] = {
        "ranking_id": ranking_id,
        "annotator": "ada",
        "episode_ids": ("a", "b", "c"),
        "ranks": (2, 1, 3),
    }
    return Ranking(**{**fields, **changes})  # type: ignore[arg-type]
