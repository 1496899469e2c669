"""What the terminal shows while a run goes on: one line a stage."""

import math
import shutil
import time
from collections.abc import Sequence
from typing import TextIO

from rapl_ros.progress import StageProgress

BAR = 20
PLAIN_PERIOD_S = 15.0
"""Seconds between two lines of a stage where the output is a file or a pipe."""


class Console:
    """Writes progress to a stream: a line that refreshes itself, or plain ones now and then.

    :param stream: normally ``sys.stdout``.
    :param terminal: whether lines may be rewritten; None: when the stream is a terminal.
    """

    def __init__(self, stream: TextIO, terminal: bool | None = None) -> None:
        self._stream = stream
        self._terminal = stream.isatty() if terminal is None else terminal
        self._open_line = False
        self._last: tuple[str, str] = ("", "")
        self._last_at = -math.inf

    def show(self, progress: StageProgress) -> None:
        """Show how far a stage is."""
        ends = progress.status in ("done", "failed")
        key = (progress.stage, progress.status)
        if key == self._last and ends:
            return
        now = time.monotonic()
        if not self._terminal and key == self._last and now - self._last_at < PLAIN_PERIOD_S:
            return
        self._last, self._last_at = key, now
        line = stage_line(progress, self._terminal)
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write("\r\x1b[K" + line[:width] + ("\n" if ends else ""))
            self._open_line = not ends
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def say(self, text: str) -> None:
        """Write a line of its own."""
        self._stream.write(("\n" if self._open_line else "") + text + "\n")
        self._open_line = False
        self._stream.flush()


def stage_line(progress: StageProgress, bar: bool = True) -> str:
    """Return the one line about a stage."""
    head = f"{progress.index}/{progress.stages} {progress.stage:9}"
    if progress.status == "waiting":
        return f"{head} waiting: {progress.detail}"
    if progress.status == "failed":
        return f"{head} failed: {progress.detail}"
    parts = [head]
    if progress.total:
        share = min(1.0, progress.done / progress.total)
        full = round(share * BAR)
        if bar:
            parts.append("█" * full + "░" * (BAR - full))
        parts.append(f"{progress.done}/{progress.total} {progress.unit}")
    if progress.rate_hz > 0:
        parts.append(f"{progress.rate_hz:.3g} {progress.unit}/s")
    if progress.status == "running":
        if math.isfinite(progress.remaining_s):
            parts.append(f"{clock(progress.remaining_s)} left")
    else:
        parts.append("done")
    if progress.detail:
        parts.append(progress.detail)
    return "  ".join(parts)


def clock(seconds: float) -> str:
    """Return ``m:ss`` or ``h:mm:ss``."""
    whole = max(0, round(seconds))
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def table(rows: Sequence[tuple[str, str]], indent: str = "  ") -> str:
    """Return two aligned columns."""
    width = max((len(left) for left, _ in rows), default=0)
    return "\n".join(f"{indent}{left:{width}}  {right}" for left, right in rows)
