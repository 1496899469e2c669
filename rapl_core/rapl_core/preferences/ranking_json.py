"""Rankings as JSON: what the store keeps in a row and what an export has in a line."""

import json
import math
from dataclasses import asdict, fields
from typing import Any

from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.types import Ranking

LATEST_NS = (2**31 - 1) * 10**9
"""What the time in a message holds; a row beyond it could be stored and never be told."""
_FIELDS = frozenset(field.name for field in fields(Ranking))


def ranking_to_json(ranking: Ranking) -> str:
    """Return one line of JSON, the same for equal rankings; an unknown response time is null."""
    return json.dumps(ranking_to_values(ranking), sort_keys=True, ensure_ascii=False)


def ranking_to_values(ranking: Ranking) -> dict[str, Any]:
    """Return its fields by name; an unknown response time is None."""
    values = asdict(ranking)
    if math.isnan(ranking.response_s):
        values["response_s"] = None
    return values


def ranking_from_json(text: str) -> Ranking:
    """Return the ranking in one line of JSON.

    :raises RankingError: if the line is no ranking; says which field is wrong.
    """
    try:
        values = json.loads(text)
    except json.JSONDecodeError as error:
        raise RankingError(f"not JSON: {error}") from error
    return ranking_from_values(values)


def ranking_from_values(values: Any) -> Ranking:
    """Return the ranking whose fields are given by name.

    :raises RankingError: if it is none; says which field is wrong.
    """
    if not isinstance(values, dict):
        raise RankingError(f"a ranking is a JSON object, got {type(values).__name__}")
    unknown = sorted(set(values) - _FIELDS)
    if unknown:
        raise RankingError(
            f"unknown fields {', '.join(unknown)}; known: {', '.join(sorted(_FIELDS))}"
        )
    try:
        response_s = values.get("response_s")
        return Ranking(
            ranking_id=_text(values, "ranking_id"),
            annotator=_text(values, "annotator"),
            episode_ids=_texts(values, "episode_ids"),
            ranks=tuple(_whole(rank, "a rank") for rank in values["ranks"]),
            verdict=values.get("verdict", "ranked"),
            query_id=_text(values, "query_id", ""),
            response_s=math.nan if response_s is None else float(response_s),
            created_ns=_whole(values.get("created_ns"), "created_ns", LATEST_NS),
            replaces=_text(values, "replaces", ""),
            shown_ns=_whole(values.get("shown_ns"), "shown_ns", LATEST_NS),
            source=_text(values, "source", ""),
        )
    except UnknownNameError as error:
        raise RankingError(str(error)) from error
    except KeyError as error:
        raise RankingError(f"a ranking lacks the field {error}") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise RankingError(f"a ranking has a field of the wrong kind: {error}") from error


def _whole(value: object, name: str, most: int = 1_000_000) -> int:
    """A number from 0 to ``most``; null, which tables have for what is unknown, is 0."""
    if value is None:
        return 0
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
        raise RankingError(f"{name} is {value!r}, expected a whole number from 0 to {most}")
    return value


def _text(values: dict[str, object], name: str, default: str | None = None) -> str:
    """A text; null or nothing is ``default``, where there is one."""
    value = values[name] if default is None else values.get(name)
    if value is None and default is not None:
        return default
    if not isinstance(value, str):
        raise RankingError(f"{name} is {value!r}, expected text")
    return value


def _texts(values: dict[str, object], name: str) -> tuple[str, ...]:
    value = values[name]
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise TypeError(f"{name} is {value!r}, expected a list of texts")
    return tuple(value)
