"""Where the time of a node goes."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class TimeShares:
    """Wall and processor seconds by purpose, e.g. physics, rendering, encoding, sac, ros.

    On a busy machine the two differ: wall time counts the waiting for a processor too.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        """Wall time."""
        self.processor_s: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def of(self, purpose: str, whole_process: bool = False) -> Iterator[None]:
        """Add the time spent within to ``purpose``.

        :param whole_process: the work is done by threads of a library, e.g. software GL; then the
            processor time of all threads counts, otherwise that of the calling one.
        """
        processor = time.process_time if whole_process else time.thread_time
        begin, begin_processor = time.perf_counter(), processor()
        try:
            yield
        finally:
            self.processor_s[purpose] += processor() - begin_processor
            self.seconds[purpose] += time.perf_counter() - begin
