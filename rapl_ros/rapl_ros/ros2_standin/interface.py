"""``ros2 interface show``."""

import argparse
import re
import sys
from collections.abc import Iterator
from typing import Any

from rapl_ros.ros2_standin.interfaces import definition_file

FIELD = re.compile(
    r"^(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?P<bound><=\d+)?(?P<array>\[[^\]]*\])?\s+"
    r"[A-Za-z][A-Za-z0-9_]*(?P<rest>.*)$"
)
PRIMITIVES = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32",
    "uint32", "int64", "uint64", "string", "wstring",
}  # fmt: skip


def add_show(verbs: Any) -> None:
    """Add ``ros2 interface show``."""
    parser = verbs.add_parser("show", help="Output the interface definition")
    comments = parser.add_mutually_exclusive_group()
    comments.add_argument(
        "--all-comments", action="store_true", help="Show the comments of nested types as well"
    )
    comments.add_argument("--no-comments", action="store_true", help="Show no comments at all")
    parser.add_argument("type", help="Type, e.g. rapl_msgs/msg/Reward; '-' reads it from stdin")
    parser.set_defaults(run=show)


def show(arguments: argparse.Namespace) -> None:
    """Print a definition with those of its nested types indented below their fields."""
    name = sys.stdin.readline().strip() if arguments.type == "-" else arguments.type
    try:
        for line in lines(name, not arguments.no_comments, arguments.all_comments):
            print(line)
    except LookupError as error:
        raise RuntimeError(str(error.args[0])) from error


def lines(name: str, comments: bool, nested_comments: bool, depth: int = 0) -> Iterator[str]:
    """Yield the lines of a definition.

    :param comments: show comments and empty lines of this definition.
    :param nested_comments: show those of the nested ones.
    :raises LookupError: if an interface is unknown.
    """
    package = name.split("/")[0]
    for raw in definition_file(name).read_text().splitlines():
        text = raw.rstrip()
        shown = text if comments else without_comment(text)
        if shown:
            yield "\t" * depth + shown
        elif comments:
            yield ""
        nested = nested_type(package, text)
        if nested:
            yield from lines(nested, nested_comments, nested_comments, depth + 1)


def without_comment(line: str) -> str:
    """Return ``line`` up to its comment; a hash inside quotes is none."""
    quote = ""
    for index, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == "#":
            return line[:index].strip()
    return line.strip()


def nested_type(package: str, line: str) -> str | None:
    """Return the message type of the field in ``line``; None for primitives and constants."""
    field = FIELD.match(without_comment(line))
    if field is None or field["type"] in PRIMITIVES or field["rest"].lstrip().startswith("="):
        return None
    owner, _, bare = field["type"].rpartition("/")
    if not owner:
        owner = "std_msgs" if bare == "Header" else package
    return f"{owner}/msg/{bare}"
