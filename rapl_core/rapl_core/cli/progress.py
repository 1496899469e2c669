"""How far long work is: a line that refreshes itself, or a few plain ones."""

import shutil
import sys
from typing import TextIO

TENTHS = 10


class Progress:
    """Writes to a stream that is not the one of the results.

    :param stream: on a terminal the line is rewritten, elsewhere it comes once a tenth; None:
        standard error.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._is_terminal = self._stream.isatty()
        self._last: tuple[str, int] = ("", -1)
        self._open_line = False

    def show(self, what: str, done: int, total: int, detail: str = "") -> None:
        """``done`` of ``total`` are done."""
        key = (what, TENTHS * done // max(total, 1))
        line = f"{what} {done}/{total}" + (f"  {detail}" if detail else "")
        if self._is_terminal:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write("\r\x1b[K" + line[:width])
            self._open_line = True
        elif key != self._last:
            self._stream.write(line + "\n")
        self._last = key
        self._stream.flush()

    def end(self) -> None:
        """What follows begins on a line of its own."""
        if self._open_line:
            self._stream.write("\n")
            self._stream.flush()
        self._open_line = False
