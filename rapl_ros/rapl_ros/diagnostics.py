"""What is wrong with a node and what it counts, on /diagnostics."""

import threading
import time
from collections import Counter
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Header

from rapl_ros import qos, topics
from rapl_ros.time_shares import TimeShares

OK: Final = DiagnosticStatus.OK
WARN: Final = DiagnosticStatus.WARN
ERROR: Final = DiagnosticStatus.ERROR

BAD_INPUT_S: Final = 10.0
"""For so long a message that was refused, or could not be worked on, stands as a condition."""


class Diagnostics:
    """Conditions, counters and shares of time of one node, published as one status.

    A condition stands until it is cleared; the status has the worst level of all. A new or worse
    condition is logged once and published at once, the rest when ``publish`` is called. May be
    used from any thread.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.RLock()
        self._publisher = node.create_publisher(
            DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics()
        )
        self._conditions: dict[str, tuple[bytes, str]] = {}
        self._ends_s: dict[str, float] = {}
        self.counters: Counter[str] = Counter()
        self.shares = TimeShares()

    def warn(self, key: str, message: str) -> None:
        """Something is missing or was dropped, and the node goes on."""
        self._set(key, WARN, message)

    def warn_for(self, seconds: float, key: str, message: str) -> None:
        """Something bad came in: a warning that ends by itself when none comes for so long."""
        self._set(key, WARN, message, seconds)

    def error_for(self, seconds: float, key: str, message: str) -> None:
        """Something bad came in that spoils a result: an error that ends by itself likewise."""
        self._set(key, ERROR, message, seconds)

    def error(self, key: str, message: str) -> None:
        """Something is wrong that somebody must repair."""
        self._set(key, ERROR, message)

    def clear(self, key: str) -> None:
        """The condition is over; say so once."""
        with self._lock:
            self._ends_s.pop(key, None)
            known = self._conditions.pop(key, None)
        if known is not None:
            self._node.get_logger().info(f"{key}: well again")
            self.publish()

    def count(self, key: str, by: int = 1) -> None:
        """Add to a counter, e.g. ``ignored_actions``."""
        with self._lock:
            self.counters[key] += by

    @property
    def conditions(self) -> dict[str, str]:
        """What stands now, by key."""
        with self._lock:
            return {key: message for key, (_, message) in self._conditions.items()}

    def publish(self) -> None:
        """Publish the status."""
        with self._lock:
            status = self._status()
        stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(DiagnosticArray(header=Header(stamp=stamp), status=[status]))

    def _status(self) -> DiagnosticStatus:
        now_s = time.monotonic()
        for key in [key for key, end_s in self._ends_s.items() if end_s < now_s]:
            del self._ends_s[key], self._conditions[key]
        name = self._node.get_fully_qualified_name()
        level = max((level for level, _ in self._conditions.values()), default=OK)
        values = [KeyValue(key=k, value=message) for k, (_, message) in self._conditions.items()]
        values += [KeyValue(key=key, value=str(n)) for key, n in sorted(self.counters.items())]
        for purpose, seconds in sorted(self.shares.seconds.items()):
            processor_s = self.shares.processor_s[purpose]
            values.append(KeyValue(key=f"{purpose}_s", value=f"{seconds:.3f}"))
            values.append(KeyValue(key=f"{purpose}_processor_s", value=f"{processor_s:.3f}"))
        return DiagnosticStatus(
            level=level,
            name=name,
            message="; ".join(self.conditions.values()) or "ok",
            hardware_id=name,
            values=values,
        )

    def _set(self, key: str, level: bytes, message: str, seconds: float | None = None) -> None:
        with self._lock:
            known = self._conditions.get(key)
            self._conditions[key] = (level, message)
            if seconds is None:
                self._ends_s.pop(key, None)
            else:
                self._ends_s[key] = time.monotonic() + seconds
        if known == (level, message):
            return
        if known is None or known[0] < level:
            logger = self._node.get_logger()
            if level == ERROR:
                logger.error(f"{key}: {message}")
            else:
                logger.warning(f"{key}: {message}")
            self.publish()
