"""How far a stage is, and how long it will take."""

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

StageStatus = Literal["waiting", "running", "done", "failed"]


@dataclass(frozen=True)
class StageProgress:
    """How far a stage is: the fields of ``rapl_msgs/Progress``."""

    stage: str
    index: int
    stages: int
    status: StageStatus
    done: int
    total: int
    unit: str
    rate_hz: float
    remaining_s: float
    """NaN when unknown."""
    detail: str = ""


def count_words(what: str, done: int, total: int, unit: str) -> str:
    """Return a count as the detail of a heartbeat has it: ``reads features: 3 of 12 videos``."""
    return f"{what}: {done} of {total} {unit}"


def count_in(words: str) -> tuple[str, int, int, str] | None:
    """Return what :func:`count_words` was given, or None where the words hold no count."""
    found = re.fullmatch(r"(.*): (\d+) of (\d+) (\w+)", words)
    return found and (found[1], int(found[2]), int(found[3]), found[4])


class ProgressMeter:
    """Turns counts of one stage into :class:`StageProgress`: adds rate and time left.

    The rate is that since the unit was first counted here, so a resumed stage does not count what
    an earlier process did.

    :param clock: steady time in seconds.
    """

    def __init__(
        self,
        stage: str,
        index: int,
        stages: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stage, self._index, self._stages = stage, index, stages
        self._clock = clock
        self._began_s = clock()
        self._first: int | None = None
        self._last = StageProgress(stage, index, stages, "running", 0, 0, "", 0.0, math.nan)

    def at(self, done: int, total: int, unit: str, detail: str = "") -> StageProgress:
        """Return the progress when ``done`` of ``total`` is reached."""
        if self._first is None or unit != self._last.unit:
            self._first, self._began_s = done, self._clock()
        spent_s, made = self._clock() - self._began_s, done - self._first
        rate_hz = made / spent_s if made > 0 and spent_s > 0 else 0.0
        remaining_s = max(0, total - done) / rate_hz if rate_hz > 0 else math.nan
        self._last = StageProgress(
            self._stage,
            self._index,
            self._stages,
            "running",
            done,
            total,
            unit,
            rate_hz,
            remaining_s,
            detail,
        )
        return self._last

    def waiting(self, detail: str) -> StageProgress:
        """Return that the stage waits, and for what."""
        return StageProgress(
            self._stage,
            self._index,
            self._stages,
            "waiting",
            self._last.done,
            self._last.total,
            self._last.unit,
            0.0,
            math.nan,
            detail,
        )

    def ended(self, status: StageStatus, detail: str = "") -> StageProgress:
        """Return that the stage is done or failed, and what it found or why."""
        last = self._last
        done = max(last.total, last.done) if status == "done" else last.done
        return StageProgress(
            self._stage,
            self._index,
            self._stages,
            status,
            done,
            last.total,
            last.unit,
            last.rate_hz,
            0.0 if status == "done" else math.nan,
            detail,
        )
