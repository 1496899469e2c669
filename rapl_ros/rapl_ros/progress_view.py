"""Shows the topic ``progress`` on the console."""

import rclpy
from rapl_msgs.msg import Progress
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rapl_ros import conversions, qos, topics
from rapl_ros.console import Console


class ProgressView:
    """A subscriber without a heartbeat: nothing depends on whether somebody watches."""

    def __init__(self, console: Console) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("run_all", namespace=topics.NAMESPACE, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(
            Progress,
            topics.PROGRESS,
            lambda msg: console.show(conversions.progress_from_ros(msg)),
            qos.progress(),
        )

    def spin(self, seconds: float) -> None:
        """Show what arrives within ``seconds``."""
        self._executor.spin_once(timeout_sec=seconds)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)
