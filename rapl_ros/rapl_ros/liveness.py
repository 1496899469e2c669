"""Heartbeats: a node says that it lives, and watches those it depends on.

The middleware's own thread keeps the lease of a heartbeat's publisher, so that a killed or stopped
process is noticed within the lease and a node in a long callback is not. The messages tell who it
is: another incarnation is a restart, silence of the executor is a node that hangs.
"""

import secrets
import time
from collections.abc import Callable
from typing import Final

from rapl_msgs.msg import Heartbeat as HeartbeatMsg
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSLivelinessChangedInfo,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from std_msgs.msg import Header

from rapl_ros import conversions, qos, topics

PERIOD_S: Final = 1.0
"""Between two heartbeat messages."""

DISCOVERY_S: Final = 10.0
"""After so long a peer that never appeared is missing; discovery takes up to 4 s under load."""

SILENCE_S: Final = 30.0
"""A living peer without a message for so long is reported as hanging."""


class Heartbeat:
    """Says that this node lives and what it does."""

    def __init__(self, node: Node) -> None:
        self.incarnation = secrets.token_hex(8)
        self.status = "starting"
        self.detail = ""
        self._name = node.get_name()
        self._publisher = node.create_publisher(
            HeartbeatMsg,
            topics.HEARTBEAT,
            qos.heartbeat(),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def beat(self) -> None:
        """Publish now."""
        self._publisher.publish(
            HeartbeatMsg(
                header=Header(stamp=conversions.time_to_ros(time.time_ns())),
                node=self._name,
                incarnation=self.incarnation,
                status=self.status,
                detail=self.detail,
            )
        )

    def report(self, status: str, detail: str = "") -> None:
        """Change status (starting, active, waiting, failed) and detail; tell at once if new."""
        if (status, detail) != (self.status, self.detail):
            self.status, self.detail = status, detail
            self.beat()


class Peer:
    """Watches the heartbeat of one other node.

    :param on_lost: called once when it goes.
    :param on_found: called when it appears; True when it is another incarnation than before.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        on_lost: Callable[[str], None],
        on_found: Callable[[str, bool], None],
    ) -> None:
        self.name = name
        self.alive = False
        self.incarnation = ""
        self.status = ""
        self.detail = ""
        self._on_lost, self._on_found = on_lost, on_found
        self.heard_s = time.monotonic()
        """When its last message came; a node in a long callback sends none."""
        self._changed_s = self.heard_s
        self._node = node
        self._subscription = node.create_subscription(
            HeartbeatMsg,
            topics.of_node(topics.HEARTBEAT, name),
            self._on_heartbeat,
            qos.heartbeat(),
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._on_liveliness, use_default_callbacks=False
            ),
        )

    def close(self) -> None:
        """Stop watching."""
        self._node.destroy_subscription(self._subscription)

    def complaint(self) -> str:
        """What is wrong with it, or an empty string."""
        now = time.monotonic()
        if not self.alive:
            since = now - self._changed_s
            if self.incarnation:
                return f"{self.name} is gone for {since:.0f} s"
            return f"{self.name} never appeared" if since > DISCOVERY_S else ""
        if now - self.heard_s > SILENCE_S:
            return f"{self.name} hangs: alive, and silent for {now - self.heard_s:.0f} s"
        return ""

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        alive = event.alive_count > 0
        if alive == self.alive:
            return
        if not alive:
            self._change(False)
            self._on_lost(self.name)
        elif self.incarnation:  # else its first message will say who it is
            self._change(True)

    def _on_heartbeat(self, msg: HeartbeatMsg) -> None:
        restarted = self.incarnation not in ("", msg.incarnation)
        is_new = msg.incarnation != self.incarnation
        self.incarnation = msg.incarnation
        self.status, self.detail = msg.status, msg.detail
        self.heard_s = time.monotonic()
        if restarted and self.alive:  # it is back sooner than the lease ran out
            self._change(False)
            self._on_lost(self.name)
        if is_new or not self.alive:
            self._change(True)
            self._on_found(self.name, restarted)

    def _change(self, alive: bool) -> None:
        self.alive = alive
        self._changed_s = self.heard_s = time.monotonic()
