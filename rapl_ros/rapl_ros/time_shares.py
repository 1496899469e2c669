"""Where the time of a node goes."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class TimeShares:
    """Wall seconds by purpose, e.g. physics, rendering, encoding, ros."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._start_s = time.monotonic()

    @contextmanager
    def of(self, purpose: str) -> Iterator[None]:
        """Add the time spent within to ``purpose``."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[purpose] += time.perf_counter() - begin

    @property
    def wall_s(self) -> float:
        """Seconds since the counting began."""
        return time.monotonic() - self._start_s
