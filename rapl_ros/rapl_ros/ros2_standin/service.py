"""``ros2 service call``."""

import argparse
from typing import Any

import rclpy
import yaml

from rapl_ros.ros2_standin.graph import observer
from rapl_ros.ros2_standin.interfaces import load_class
from rapl_ros.ros2_standin.message_text import fill


def add_call(verbs: Any) -> None:
    """Add ``ros2 service call``."""
    parser = verbs.add_parser("call", help="Call a service")
    parser.add_argument("service_name", help="Name of the service, e.g. /rapl/simulator/reset")
    parser.add_argument("service_type", help="Type of the service, e.g. rapl_msgs/srv/Reset")
    parser.add_argument(
        "values", nargs="?", default="{}", help="Fields of the request as YAML, e.g. '{a: 1, b: 2}'"
    )
    parser.set_defaults(run=call)


def call(arguments: argparse.Namespace) -> None:
    """Call a service and print request and response."""
    try:
        service_class = load_class(arguments.service_type, "srv")
    except LookupError as error:
        raise RuntimeError("The passed service type is invalid") from error
    request = service_class.Request()
    try:
        fill(request, yaml.safe_load(arguments.values))
    except (AttributeError, AssertionError, TypeError, ValueError, yaml.YAMLError) as error:
        raise RuntimeError(f"Failed to populate field: {error}") from error
    with observer() as node:
        client = node.create_client(service_class, arguments.service_name)
        if not client.wait_for_service(timeout_sec=1.0):
            print("waiting for service to become available...", flush=True)
            client.wait_for_service()
        print(f"requester: making request: {request!r}\n", flush=True)
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future)
        if future.result() is None:
            raise RuntimeError(f"Exception while calling service: {future.exception()!r}")
        print(f"response:\n{future.result()!r}\n")
