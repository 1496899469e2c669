"""The stages of a run as they stand, kept in ``stages.json`` of its folder.

The conductor writes it, a resumed run begins where it stops, and the report reads its times.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rapl_core.atomic import write_atomically
from rapl_core.errors import CorruptFileError

STAGES_FILE = "stages.json"

Status = Literal["waiting", "running", "done", "failed", "skipped"]


@dataclass(frozen=True)
class StageRecord:
    """How one stage of a run stands."""

    name: str
    status: Status = "waiting"
    seconds: float = 0.0
    """Wall time spent in it, all attempts together."""
    attempts: int = 0
    detail: str = ""
    """Why it failed or was skipped."""
    result: Mapping[str, Any] = field(default_factory=dict)
    """What it found, for example ``{"triplets": 150}``."""


class StageBook:
    """Reads and writes ``stages.json``; every change is on disk when its method returns.

    Its methods raise RaplError when the file cannot be written.
    """

    def __init__(self, run_folder: Path) -> None:
        self._path = run_folder / STAGES_FILE
        self._records = {record.name: record for record in read_stages(run_folder)}

    def __getitem__(self, name: str) -> StageRecord:
        return self._records.get(name, StageRecord(name))

    @property
    def records(self) -> tuple[StageRecord, ...]:
        """All stages, in the order in which they were first touched."""
        return tuple(self._records.values())

    def begin(self, name: str) -> None:
        """Note that ``name`` runs (again)."""
        old = self[name]
        self._put(replace(old, status="running", attempts=old.attempts + 1, detail=""))

    def spend(self, name: str, seconds: float) -> None:
        """Add wall time to ``name``."""
        self._put(replace(self[name], seconds=self[name].seconds + seconds))

    def finish(self, name: str, result: Mapping[str, Any]) -> None:
        """Note that ``name`` is done and what it found."""
        self._put(replace(self[name], status="done", detail="", result=dict(result)))

    def fail(self, name: str, detail: str) -> None:
        """Note that ``name`` failed and why."""
        self._put(replace(self[name], status="failed", detail=detail))

    def forget(self, names: Iterable[str]) -> None:
        """Note that what these stages found no longer counts; their times stay."""
        for name in names:
            if self[name].status != "waiting":
                self._put(replace(self[name], status="waiting", detail="", result={}))

    def skip(self, name: str, detail: str) -> None:
        """Note that this run does without ``name``."""
        self._put(replace(self[name], status="skipped", detail=detail))

    def _put(self, record: StageRecord) -> None:
        self._records[record.name] = record
        text = json.dumps(plain([asdict(r) for r in self._records.values()]), indent=1)
        write_atomically(self._path, text)


def read_stages(run_folder: Path) -> tuple[StageRecord, ...]:
    """Return the stages of a run; empty when it has not begun.

    :raises CorruptFileError: if the file cannot be read.
    """
    path = run_folder / STAGES_FILE
    try:
        return tuple(StageRecord(**entry) for entry in json.loads(path.read_text()))
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, TypeError) as error:
        raise CorruptFileError(f"cannot read {path}: {error}") from error


def plain(value: Any) -> Any:
    """Return ``value`` as strict JSON has it: what is not finite is null, no numpy."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
