"""``ros2 topic echo``, ``hz`` and ``info``."""

import argparse
import math
import time
from collections import deque
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from rapl_ros.ros2_standin.graph import observer, settle
from rapl_ros.ros2_standin.interfaces import load_class
from rapl_ros.ros2_standin.message_text import TRUNCATE_LENGTH, to_yaml
from rapl_ros.ros2_standin.subscription import (
    add_qos_arguments,
    asked_profile,
    full_topic_name,
    matching_profile,
    topic_class,
    topic_types,
)


def add_echo(verbs: Any) -> None:
    """Add ``ros2 topic echo``."""
    parser = verbs.add_parser("echo", help="Output messages from a topic")
    parser.add_argument("topic_name", help="Name of the topic, e.g. /rapl/reward")
    parser.add_argument("message_type", nargs="?", help="Type of its messages")
    add_qos_arguments(parser)
    parser.add_argument("--field", help="Echo a selected field, e.g. header.stamp")
    parser.add_argument(
        "--full-length", "-f", action="store_true", help="Output all elements of arrays and strings"
    )
    parser.add_argument(
        "--truncate-length",
        "-l",
        type=int,
        default=TRUNCATE_LENGTH,
        metavar="N",
        help=f"The length to truncate arrays and strings to (default: {TRUNCATE_LENGTH})",
    )
    parser.add_argument("--no-arr", action="store_true", help="Don't print array fields")
    parser.add_argument("--no-str", action="store_true", help="Don't print string fields")
    parser.add_argument("--flow-style", action="store_true", help="Print on one line")
    parser.add_argument("--once", action="store_true", help="Print the first message and exit")
    parser.add_argument("--timeout", metavar="N", type=float, help="Seconds after which to exit")
    parser.set_defaults(run=echo)


def echo(arguments: argparse.Namespace) -> None:
    """Print messages as YAML documents."""
    with observer() as node:
        topic = full_topic_name(node, arguments.topic_name)
        message_class = _echo_class(node, topic, arguments.message_type)
        profile = asked_profile(arguments) or matching_profile(node, topic, arguments.qos_profile)
        received = 0

        def show(message: Any) -> None:
            nonlocal received
            if arguments.once and received:
                return
            received += 1
            print(_document(message, arguments), end="---\n", flush=True)

        node.create_subscription(message_class, topic, show, profile)
        deadline = math.inf if arguments.timeout is None else time.monotonic() + arguments.timeout
        while rclpy.ok() and time.monotonic() < deadline and not (arguments.once and received):
            rclpy.spin_once(node, timeout_sec=0.1)


def _echo_class(node: Node, topic: str, message_type: str | None) -> Any:
    if message_type is None:
        return topic_class(node, topic, wait=False)
    settle(node)  # the publishers' profiles are looked at next
    try:
        return load_class(message_type, "msg")
    except LookupError as error:
        raise RuntimeError("The passed message type is invalid") from error


def _document(message: Any, arguments: argparse.Namespace) -> str:
    for name in filter(None, (arguments.field or "").split(".")):
        try:
            message = getattr(message, name)
        except AttributeError as error:
            raise RuntimeError(f"Invalid field '{arguments.field}': {error}") from error
    if not hasattr(message, "get_fields_and_field_types"):
        return f"{message}\n"
    return to_yaml(
        message,
        truncate=None if arguments.full_length else arguments.truncate_length,
        no_arr=arguments.no_arr,
        no_str=arguments.no_str,
        flow_style=arguments.flow_style,
    )


def add_hz(verbs: Any) -> None:
    """Add ``ros2 topic hz``."""
    parser = verbs.add_parser("hz", help="Print the average publishing rate to screen")
    parser.add_argument("topic_name", help="Name of the topic, e.g. /rapl/camera/image_raw")
    parser.add_argument(
        "--window", "-w", type=int, default=10_000, help="Messages to average over (10000)"
    )
    parser.set_defaults(run=hz)


class RateMeter:
    """Rate of arrivals over a window.

    :param window: number of intervals to average over.
    """

    def __init__(self, window: int) -> None:
        self._intervals_s: deque[float] = deque(maxlen=window)
        self._last_s: float | None = None

    def arrive(self, now_s: float) -> None:
        """Note the arrival of a message."""
        if self._last_s is not None:
            self._intervals_s.append(now_s - self._last_s)
        self._last_s = now_s

    def text(self) -> str | None:
        """Return what ``hz`` prints; None before the second message."""
        intervals = self._intervals_s
        if not intervals:
            return None
        mean = sum(intervals) / len(intervals)
        deviation = math.sqrt(sum((x - mean) ** 2 for x in intervals) / len(intervals))
        rate = 1.0 / mean if mean > 0 else 0.0
        return (
            f"average rate: {rate:.3f}\n\tmin: {min(intervals):.3f}s max: {max(intervals):.3f}s "
            f"std dev: {deviation:.5f}s window: {len(intervals)}"
        )


def hz(arguments: argparse.Namespace) -> None:
    """Print the rate every second for as long as messages arrive."""
    meter = RateMeter(arguments.window)
    arrivals = printed_arrivals = 0

    def arrive(_: bytes) -> None:
        nonlocal arrivals
        arrivals += 1
        meter.arrive(time.monotonic())

    with observer() as node:
        topic = full_topic_name(node, arguments.topic_name)
        message_class = topic_class(node, topic, wait=True)
        # raw: counting messages needs no deserialisation, which would cost more than it measures
        node.create_subscription(message_class, topic, arrive, qos_profile_sensor_data, raw=True)
        printed_s = time.monotonic()
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=0.1)
            if time.monotonic() - printed_s < 1.0 or arrivals == printed_arrivals:
                continue
            printed_s, printed_arrivals = time.monotonic(), arrivals
            if (text := meter.text()) is not None:
                print(text, flush=True)


def add_info(verbs: Any) -> None:
    """Add ``ros2 topic info``."""
    parser = verbs.add_parser("info", help="Print information about a topic")
    parser.add_argument("topic_name", help="Name of the topic, e.g. /rapl/reward")
    parser.add_argument("--verbose", "-v", action="store_true", help="Nodes and profiles as well")
    parser.set_defaults(run=info)


def info(arguments: argparse.Namespace) -> None:
    """Print type and number of publishers and subscriptions."""
    end = "\n\n" if arguments.verbose else "\n"
    with observer() as node:
        settle(node)
        topic = arguments.topic_name
        types = topic_types(node, topic)
        if not types:
            raise RuntimeError(f"Unknown topic '{topic}'")
        print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
        print(f"Publisher count: {node.count_publishers(topic)}", end=end)
        if arguments.verbose:
            for endpoint in node.get_publishers_info_by_topic(topic):
                print(endpoint, end=end)
        print(f"Subscription count: {node.count_subscribers(topic)}", end=end)
        if arguments.verbose:
            for endpoint in node.get_subscriptions_info_by_topic(topic):
                print(endpoint, end=end)
