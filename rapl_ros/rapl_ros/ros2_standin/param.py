"""``ros2 param list``, ``get``, ``set`` and ``describe``."""

import argparse
import sys
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from rapl_ros.ros2_standin.graph import (
    DISCOVERY_S,
    absolute,
    node_names,
    observer,
    require_node,
    settle,
)

SERVICES_S = 5.0
"""Wait for the parameter services of a node that is there."""

VALUE_LABELS = {
    ParameterType.PARAMETER_BOOL: "Boolean value is:",
    ParameterType.PARAMETER_INTEGER: "Integer value is:",
    ParameterType.PARAMETER_DOUBLE: "Double value is:",
    ParameterType.PARAMETER_STRING: "String value is:",
    ParameterType.PARAMETER_BYTE_ARRAY: "Byte values are:",
    ParameterType.PARAMETER_BOOL_ARRAY: "Boolean values are:",
    ParameterType.PARAMETER_INTEGER_ARRAY: "Integer values are:",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "Double values are:",
    ParameterType.PARAMETER_STRING_ARRAY: "String values are:",
}
TYPE_NAMES = {
    ParameterType.PARAMETER_NOT_SET: "not set",
    ParameterType.PARAMETER_BOOL: "boolean",
    ParameterType.PARAMETER_INTEGER: "integer",
    ParameterType.PARAMETER_DOUBLE: "double",
    ParameterType.PARAMETER_STRING: "string",
    ParameterType.PARAMETER_BYTE_ARRAY: "byte array",
    ParameterType.PARAMETER_BOOL_ARRAY: "boolean array",
    ParameterType.PARAMETER_INTEGER_ARRAY: "integer array",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double array",
    ParameterType.PARAMETER_STRING_ARRAY: "string array",
}


def _add(verbs: Any, verb: str, run: Any, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(verb, help=text)
    parser.add_argument("node_name", nargs="?" if verb == "list" else None, help="Name of the node")
    parser.add_argument(
        "--timeout",
        metavar="N",
        type=float,
        default=DISCOVERY_S,
        help="Wait for N seconds until the node becomes available (default %(default)s)",
    )
    parser.set_defaults(run=run)
    return parser


def add_list(verbs: Any) -> None:
    """Add ``ros2 param list``."""
    parser = _add(verbs, "list", list_parameters, "Output a list of available parameters")
    parser.add_argument("--include-hidden-nodes", action="store_true")
    parser.add_argument("--param-prefixes", nargs="+", default=[], metavar="PREFIX")
    parser.add_argument("--param-type", action="store_true", help="Print the types as well")


def add_get(verbs: Any) -> None:
    """Add ``ros2 param get``."""
    parser = _add(verbs, "get", get_parameter, "Get parameter")
    parser.add_argument("parameter_name", help="Name of the parameter")
    parser.add_argument("--hide-type", action="store_true", help="Hide the type information")


def add_set(verbs: Any) -> None:
    """Add ``ros2 param set``."""
    parser = _add(verbs, "set", set_parameter, "Set parameter")
    parser.add_argument("parameter_name", help="Name of the parameter")
    parser.add_argument("value", help="Value of the parameter")


def add_describe(verbs: Any) -> None:
    """Add ``ros2 param describe``."""
    parser = _add(verbs, "describe", describe_parameters, "Show descriptions of parameters")
    parser.add_argument("parameter_names", nargs="+", help="Names of the parameters")


def _client(node: Node, node_name: str) -> AsyncParameterClient | None:
    client = AsyncParameterClient(node, node_name)
    return client if client.wait_for_services(timeout_sec=SERVICES_S) else None


def _required_client(node: Node, arguments: argparse.Namespace) -> AsyncParameterClient:
    require_node(node, arguments.node_name, arguments.timeout)
    client = _client(node, absolute(arguments.node_name))
    if client is None:
        raise RuntimeError(
            "Wait for service timed out waiting for parameter services for node "
            f"{arguments.node_name}"
        )
    return client


def _answer(node: Node, node_name: str, future: Future) -> Any:
    """Return the answer to a call; like the real command it waits for it without a deadline,
    since an on-set callback may be long."""
    rclpy.spin_until_future_complete(node, future)
    if future.result() is None:
        raise RuntimeError(
            f"Exception while calling service of node {node_name}: {future.exception()}"
        )
    return future.result()


def list_parameters(arguments: argparse.Namespace) -> None:
    """Print parameter names, under the names of their nodes unless one node was asked for."""
    with observer() as node:
        if arguments.node_name:
            require_node(node, arguments.node_name, arguments.timeout)
            names = [absolute(arguments.node_name)]
        else:
            settle(node)
            hidden = arguments.include_hidden_nodes
            names = sorted({name.full for name in node_names(node, hidden)})
        for name in names:
            client = _client(node, name)
            if client is None:
                print(f"Wait for service timed out waiting for parameter services for node {name}")
                continue
            answer = _answer(node, name, client.list_parameters(prefixes=arguments.param_prefixes))
            found = sorted(answer.result.names)
            if not arguments.node_name and found:
                print(f"{name}:")
            types = _types(node, name, client, found) if arguments.param_type else {}
            for parameter in found:
                suffix = f" (type: {types[parameter]})" if parameter in types else ""
                print(f"  {parameter}{suffix}")


def _types(node: Node, name: str, client: Any, parameters: list[str]) -> dict[str, str]:
    descriptors = _answer(node, name, client.describe_parameters(parameters)).descriptors
    return {descriptor.name: TYPE_NAMES[descriptor.type] for descriptor in descriptors}


def get_parameter(arguments: argparse.Namespace) -> None:
    """Print the value of a parameter."""
    with observer() as node:
        client = _required_client(node, arguments)
        future = client.get_parameters([arguments.parameter_name])
        values = _answer(node, arguments.node_name, future).values
    if not values:
        raise RuntimeError("Parameter not set")
    if values[0].type == ParameterType.PARAMETER_NOT_SET:
        print("Parameter not set.")
        return
    value = parameter_value_to_python(values[0])
    if hasattr(value, "tolist"):
        value = value.tolist()
    print(value) if arguments.hide_type else print(VALUE_LABELS[values[0].type], value)


def set_parameter(arguments: argparse.Namespace) -> None:
    """Set a parameter and print whether the node took it."""
    value = get_parameter_value(string_value=arguments.value)
    parameter = Parameter(name=arguments.parameter_name, value=value)
    with observer() as node:
        client = _required_client(node, arguments)
        answer = _answer(node, arguments.node_name, client.set_parameters([parameter]))
    result = answer.results[0]
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        print(f"Set parameter successful{reason}")
    else:
        print(f"Setting parameter failed{reason}", file=sys.stderr)


def describe_parameters(arguments: argparse.Namespace) -> None:
    """Print type, description and constraints of parameters."""
    with observer() as node:
        client = _required_client(node, arguments)
        future = client.describe_parameters(arguments.parameter_names)
        for descriptor in _answer(node, arguments.node_name, future).descriptors:
            _print_descriptor(descriptor)


def _print_descriptor(descriptor: ParameterDescriptor) -> None:
    print("Parameter name:", descriptor.name)
    print("  Type:", TYPE_NAMES[descriptor.type])
    if descriptor.description:
        print("  Description:", descriptor.description)
    print("  Constraints:")
    if descriptor.read_only:
        print("    Read only: true")
    for bounds in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
        print("    Min value:", bounds.from_value)
        print("    Max value:", bounds.to_value)
        if bounds.step:
            print("    Step:", bounds.step)
    if descriptor.additional_constraints:
        print("    Additional constraints:", descriptor.additional_constraints)
