"""Alignments made while the robot learns, kept in ``online.json`` of the run's folder.

The conductor writes it, a resumed run goes on from it, and the report marks them on the curve.
"""

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rapl_core.analysis.stages import plain
from rapl_core.errors import CorruptFileError

ONLINE_FILE = "online.json"


@dataclass(frozen=True)
class OnlineAlignment:
    """One alignment beside the training."""

    asked_steps: int
    """World steps of training when the asking began."""
    wanted: int
    """Rankings in all that it waits for."""
    steps: int = 0
    """World steps when its encoder was put to work; 0: not yet."""
    rankings: int = 0
    """That it learnt from."""
    version: str = ""
    held_out_accuracy: float = math.nan
    """NaN where nothing was held out."""

    @property
    def is_done(self) -> bool:
        """Whether its encoder is at work."""
        return bool(self.version)


class OnlineBook:
    """Reads and writes ``online.json``; every change is on disk when its method returns."""

    def __init__(self, run_folder: Path) -> None:
        self._path = run_folder / ONLINE_FILE
        self._entries = list(read_online(run_folder))

    @property
    def done(self) -> int:
        """Alignments whose encoder was put to work."""
        return sum(entry.is_done for entry in self._entries)

    def begin(self, steps: int, wanted: int) -> OnlineAlignment:
        """The alignment under way; begins one where there is none."""
        if not self._entries or self._entries[-1].is_done:
            self._entries.append(OnlineAlignment(steps, wanted))
            self._write()
        return self._entries[-1]

    @property
    def under_way(self) -> OnlineAlignment | None:
        """The alignment that was begun and is not done."""
        return self._entries[-1] if self._entries and not self._entries[-1].is_done else None

    def finish(self, steps: int, rankings: int, version: str, held_out_accuracy: float) -> None:
        """The encoder of the alignment under way is at work."""
        self._entries[-1] = replace(
            self._entries[-1],
            steps=steps,
            rankings=rankings,
            version=version,
            held_out_accuracy=held_out_accuracy,
        )
        self._write()

    def _write(self) -> None:
        text = json.dumps(plain([asdict(entry) for entry in self._entries]), indent=1)
        beside = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        beside.write_text(text + "\n")
        beside.replace(self._path)


def read_online(run_folder: Path) -> Sequence[OnlineAlignment]:
    """Return the alignments made while the robot learnt; empty without any.

    :raises CorruptFileError: if the file cannot be read.
    """
    path = run_folder / ONLINE_FILE
    try:
        entries = json.loads(path.read_text())
        return [
            OnlineAlignment(**{**entry, "held_out_accuracy": _number(entry["held_out_accuracy"])})
            for entry in entries
        ]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise CorruptFileError(f"cannot read {path}: {error}") from error


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
