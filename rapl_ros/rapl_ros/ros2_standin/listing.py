"""Verbs that list: nodes, topics, services and actions."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.action import get_action_names_and_types
from rclpy.node import Node

from rapl_ros.ros2_standin.graph import is_hidden, node_names, observer, settle

NamesAndTypes = Sequence[tuple[str, Sequence[str]]]


def add_node_list(verbs: Any) -> None:
    """Add ``ros2 node list``."""
    parser = verbs.add_parser("list", help="Output a list of available nodes")
    parser.add_argument("-a", "--all", action="store_true", help="Display hidden nodes as well")
    parser.add_argument("-c", "--count-nodes", action="store_true", help="Only display the number")
    parser.set_defaults(run=list_nodes)


def list_nodes(arguments: argparse.Namespace) -> None:
    """Print the full names of the nodes, sorted."""
    with observer() as node:
        settle(node)
        names = sorted(name.full for name in node_names(node, arguments.all))
    if arguments.count_nodes:
        print(len(names))
        return
    if len(set(names)) < len(names):
        print(
            "WARNING: Be aware that there are nodes in the graph that share an exact name, which "
            "can have unintended side effects.",
            file=sys.stderr,
        )
    if names:
        print(*names, sep="\n")


def add_list(verbs: Any, kind: str) -> None:
    """Add ``ros2 topic list``, ``ros2 service list`` or ``ros2 action list``.

    :param kind: ``topic``, ``service`` or ``action``.
    """
    parser = verbs.add_parser("list", help=f"Output a list of available {kind}s")
    parser.add_argument("-t", "--show-types", action="store_true", help="Show the types as well")
    parser.add_argument(
        "-c", f"--count-{kind}s", dest="count", action="store_true", help="Only display the number"
    )
    if kind != "action":
        parser.add_argument(
            f"--include-hidden-{kind}s",
            dest="include_hidden",
            action="store_true",
            help=f"Consider hidden {kind}s as well",
        )
    parser.set_defaults(run=list_names, kind=kind, include_hidden=False)


def list_names(arguments: argparse.Namespace) -> None:
    """Print names, with their types in brackets where asked for."""
    find: dict[str, Callable[[Node], NamesAndTypes]] = {
        "topic": lambda node: node.get_topic_names_and_types(),
        "service": lambda node: node.get_service_names_and_types(),
        "action": get_action_names_and_types,
    }
    with observer() as node:
        settle(node)
        found = find[arguments.kind](node)
    shown = [entry for entry in found if arguments.include_hidden or not is_hidden(entry[0])]
    if arguments.count:
        print(len(shown))
        return
    for name, types in sorted(shown):
        print(f"{name} [{', '.join(types)}]" if arguments.show_types else name)
