"""One run at a time in a folder: a lock that ends with the process that holds it."""

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from rapl_core.errors import RaplError

LOCK_FILE = ".running"
"""Has the process id of who holds it; stays when the run is over."""


class RunLock:
    """Held from its making until it is closed, or its process ends in whatever way.

    :param folder: of the run.
    :param or_by: a process that may hold it instead, such as the parent that has it for its
        children.
    :raises RaplError: if another process holds it; names it.
    """

    def __init__(self, folder: Path, or_by: int | None = None) -> None:
        path = folder / LOCK_FILE
        try:
            self._file = path.open("a+", encoding="ascii")  # children do not inherit it
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            holder = _holder(path)
            if or_by is None or holder != or_by:
                raise RaplError(_words(holder, folder)) from error
        except OSError as error:
            raise RaplError(f"cannot lock {path}: {error.strerror}") from error
        else:
            self._file.truncate(0)
            print(os.getpid(), file=self._file, flush=True)

    def close(self) -> None:
        """Let go."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def is_running(folder: Path) -> bool:
    """Whether a run is at work in ``folder``."""
    try:
        with (folder / LOCK_FILE).open(encoding="ascii") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def refuse_if_running(folder: Path) -> None:
    """
    :raises RaplError: if a run is at work in ``folder``; names its process.
    """
    if is_running(folder):
        raise RaplError(_words(_holder(folder / LOCK_FILE), folder))


def _holder(path: Path) -> int:
    """Its process id; 0 where it has not written it yet."""
    text = path.read_text(encoding="ascii").strip()
    return int(text) if text.isdigit() else 0


def _words(holder: int, folder: Path) -> str:
    who = f"process {holder}" if holder else "another process"
    return f"{who} is at work in {folder}: wait for its end, or take another folder"
