"""What every node has: heartbeat, peers, diagnostics, timers on steady time and a main loop."""

import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_policy_name_from_kind
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from rapl_core.errors import RaplError
from rapl_ros import qos, topics
from rapl_ros.diagnostics import Diagnostics
from rapl_ros.liveness import PERIOD_S, Heartbeat, Peer


class RaplNode(Node):
    """Base of the nodes.

    Publishes ``~/heartbeat`` (rapl_msgs/Heartbeat, latched, lease 2 s) and ``/diagnostics``
    (diagnostic_msgs/DiagnosticArray, 1 Hz), and watches the heartbeats of its peers.

    :param name: the node's name in the namespace ``rapl``.
    :param peers: names of the nodes that it depends on.
    """

    def __init__(self, name: str, peers: Iterable[str] = (), **options: Any) -> None:
        options.setdefault("namespace", topics.NAMESPACE)
        super().__init__(name, **options)
        self.exit_code = 0
        """Of its process after a signal, or after the node itself has shut ROS down."""
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.diagnostics = Diagnostics(self)
        self.heartbeat = Heartbeat(self)
        self.peers: dict[str, Peer] = {}
        for peer in peers:
            self.watch(peer)
        self.heartbeat.beat()
        self.steady_timer(PERIOD_S, self._on_second)

    # For the nodes to use

    def publish_to(self, message_type: type, topic: str, profile: QoSProfile) -> Publisher:
        """Create a publisher without event handlers: each would cost time in every wait."""
        return self.create_publisher(
            message_type,
            topic,
            profile,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def subscribe_to(
        self,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        profile: QoSProfile,
        overridable: bool = False,
    ) -> Subscription:
        """Create a subscription; a publisher with an incompatible QoS is an error on /diagnostics.

        :param overridable: whether parameters ``qos_overrides.<topic>.subscription.*`` exist.
        """

        def on_incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            cure = f"; set qos_overrides.{resolved}.subscription" if overridable else ""
            self.diagnostics.error(
                f"qos of {topic}",
                f"{event.total_count} publishers of {topic} offer an incompatible QoS "
                f"({policy}): nothing is received from them{cure}",
            )

        resolved = self.resolve_topic_name(topic)
        return self.create_subscription(
            message_type,
            topic,
            callback,
            profile,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=on_incompatible, use_default_callbacks=False
            ),
            qos_overriding_options=qos.overrides() if overridable else None,
        )

    def steady_timer(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """Create a timer on steady time: one on /clock stops when the simulator does."""
        return self.create_timer(period_s, callback, clock=self._steady)

    def watch(self, peer: str) -> None:
        """Watch a further peer from now on."""
        if peer not in self.peers:
            self.peers[peer] = Peer(self, peer, self._on_peer_lost, self._on_peer_found)

    def unwatch(self, peer: str) -> None:
        """Watch a peer no longer."""
        if peer in self.peers:
            self.peers.pop(peer).close()
            self.diagnostics.clear(f"peer {peer}")

    def missing_peers(self) -> list[str]:
        """Names of the peers that are not alive now."""
        return [name for name, peer in self.peers.items() if not peer.alive]

    # For the nodes to override

    def peer_lost(self, peer: str) -> None:
        """``peer`` has gone; called once."""

    def peer_found(self, peer: str, restarted: bool) -> None:
        """``peer`` has appeared; ``restarted`` when it is another process than before."""

    def close(self) -> None:
        """Stop threads, release files; called once before the node is destroyed."""

    # The rest is the base's own

    def _on_peer_lost(self, peer: str) -> None:
        self.diagnostics.warn(f"peer {peer}", f"{peer} is gone")
        self.peer_lost(peer)

    def _on_peer_found(self, peer: str, restarted: bool) -> None:
        self.diagnostics.clear(f"peer {peer}")
        if restarted:
            self.get_logger().info(f"{peer} has restarted")
        self.peer_found(peer, restarted)

    def _on_second(self) -> None:
        for name, peer in self.peers.items():
            complaint = peer.complaint()
            if complaint:
                self.diagnostics.warn(f"peer {name}", complaint)
            else:
                self.diagnostics.clear(f"peer {name}")
        self.heartbeat.beat()
        self.diagnostics.publish()


def run(make_node: Callable[[], RaplNode], args: Sequence[str] | None = None) -> int:
    """Spin a node until SIGINT or SIGTERM and return the exit code of its process.

    :return: the node's ``exit_code`` after a signal, 1 after an error; a RaplError is told in one
        line, any other with its traceback.
    """
    rclpy.init(args=None if args is None else list(args))
    executor = SingleThreadedExecutor()
    node: RaplNode | None = None
    code = 0
    try:
        node = make_node()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RaplError as error:
        get_logger(node.get_name() if node else "rapl").fatal(str(error))
        code = 1
    except Exception:
        # Where a signal has just shut ROS down, whatever was being published or created fails;
        # otherwise it is a fault of ours: told in full, and the exit code says so.
        if rclpy.ok():
            get_logger(node.get_name() if node else "rapl").fatal(traceback.format_exc())
            code = 1
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        executor.shutdown(timeout_sec=1.0)
        rclpy.try_shutdown()
    return code or (node.exit_code if node is not None else 0)


def main(make_node: Callable[[], RaplNode]) -> None:
    """End the process with the exit code of ``run``: the body of an entry point."""
    sys.exit(run(make_node))
