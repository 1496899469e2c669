"""Simulation time that only goes forward, also across restarts of the simulator."""

import json
import os
import time
from pathlib import Path

from rapl_core.atomic import write_atomically
from rapl_core.errors import RaplError

RESERVE_NS = 3_600_000_000_000
"""Simulated hours are set aside in blocks of one, so that the file is seldom written."""
SECOND_NS = 1_000_000_000


class SimClock:
    """Stamps for the instants of a simulation.

    It starts at the wall clock, or at the end of what an earlier simulator set aside where that is
    later: a simulator runs faster than the wall clock, so its last stamps lie in the future.

    :param file: keeps how far time is set aside; its folder is created.
    :param period_s: simulated time of one control period.
    :raises RaplError: if the file cannot be read or written.
    """

    def __init__(self, file: Path, period_s: float) -> None:
        self._file = file
        self._period_ns = round(period_s * SECOND_NS)
        if self._period_ns < 1:
            raise RaplError(f"a control period of {period_s} s is shorter than a nanosecond")
        start = max(time.time_ns(), self._read())
        self._now_ns = -(-start // SECOND_NS) * SECOND_NS
        self._reserved_ns = self._now_ns
        self._reserve()

    @property
    def now_ns(self) -> int:
        """The instant that was given last."""
        return self._now_ns

    def advance(self) -> int:
        """Go on by one control period and return the new instant in nanoseconds."""
        self._now_ns += self._period_ns
        if self._now_ns > self._reserved_ns:
            self._reserve()
        return self._now_ns

    def _reserve(self) -> None:
        until = self._now_ns + RESERVE_NS
        text = json.dumps({"reserved_until_ns": until}) + "\n"
        write_atomically(self._file, text, "simulation time to")
        self._reserved_ns = until

    def _read(self) -> int:
        try:
            return int(json.loads(self._file.read_text())["reserved_until_ns"])
        except FileNotFoundError:
            return 0
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RaplError(
                f"{self._file} does not say how far simulation time went ({error}); "
                "remove it if no recorded episode is to be continued"
            ) from error


def default_clock_file() -> Path:
    """Return ``simulator_clock.json`` in the folder of ROS for users' files."""
    home = os.environ.get("ROS_HOME") or os.path.join(os.path.expanduser("~"), ".ros")
    return Path(home) / "rapl" / "simulator_clock.json"
