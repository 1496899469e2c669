"""What there is to know about an episode on disk without opening its bag."""

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from rapl_core.errors import CorruptFileError
from rapl_core.types import Episode

SUMMARY_FILE = "summary.json"

FORMAT = 1


@dataclass(frozen=True)
class EpisodeSummary:
    """The side file of an episode's bag."""

    episode_id: str
    task: str
    world: int
    purpose: str
    controller: str
    behaviour: str
    steps: int
    """T."""
    terminated: bool
    """The task ended rather than the time."""
    first_stamp_ns: int
    last_stamp_ns: int
    image_height: int
    image_width: int
    has_truth: bool
    human_return: float
    """Sum of r* over the T states arrived in; NaN where unknown."""
    success: bool | None
    """None where unknown."""
    sha256: str
    """Of the bag's .mcap file, in hex."""


def summarise(episode: Episode, terminated: bool, sha256: str) -> EpisodeSummary:
    """Return the summary of an episode whose bag has the hash ``sha256``."""
    return EpisodeSummary(
        episode_id=episode.episode_id,
        task=episode.task,
        world=int(episode.world),
        purpose=episode.purpose,
        controller=episode.controller,
        behaviour=episode.behaviour,
        steps=episode.steps,
        terminated=terminated,
        first_stamp_ns=int(episode.stamps_ns[0]),
        last_stamp_ns=int(episode.stamps_ns[-1]),
        image_height=episode.frames.shape[1],
        image_width=episode.frames.shape[2],
        has_truth=episode.human_rewards is not None,
        human_return=episode.human_return,
        success=None if episode.success is None else bool(episode.success),
        sha256=sha256,
    )


def summary_to_json(summary: EpisodeSummary) -> str:
    """Return ``summary`` as JSON; what is unknown is null."""
    values = {"format": FORMAT, **asdict(summary)}
    if math.isnan(summary.human_return):
        values["human_return"] = None
    return json.dumps(values, indent=1) + "\n"


def read_summary(path: Path) -> EpisodeSummary:
    """Return the summary of the episode in the folder ``path``.

    :raises CorruptFileError: if it is missing or cannot be understood; names the file.
    """
    file = path / SUMMARY_FILE
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        stored = values.pop("format")
        if stored != FORMAT:
            raise CorruptFileError(f"{file} has the format {stored}, expected {FORMAT}")
        if values["human_return"] is None:
            values["human_return"] = math.nan
        summary = EpisodeSummary(**values)
        _check_kinds(summary)
    except OSError as error:
        raise CorruptFileError(f"{file} cannot be read: {error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CorruptFileError(f"{file} is no summary of an episode: {error}") from error
    return summary


def _check_kinds(summary: EpisodeSummary) -> None:
    kinds = {int: int, str: str, bool: bool, float: (int, float), bool | None: (bool, type(None))}
    for field in fields(summary):
        value = getattr(summary, field.name)
        if not isinstance(value, kinds[field.type]):  # type: ignore[arg-type, index]
            raise TypeError(f"{field.name} is {value!r}")
