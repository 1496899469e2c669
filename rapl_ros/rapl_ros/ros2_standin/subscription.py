"""The type and the quality of service with which to listen to a topic."""

import argparse
from typing import Any

from rclpy.duration import Duration
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPresetProfiles,
    QoSProfile,
    ReliabilityPolicy,
)

from rapl_ros.ros2_standin.graph import DISCOVERY_S, wait_for
from rapl_ros.ros2_standin.interfaces import load_class


def full_topic_name(node: Node, topic: str) -> str:
    """Return the absolute name of ``topic``.

    :raises RuntimeError: if it is not a topic's name.
    """
    try:
        return str(expand_topic_name(topic, node.get_name(), node.get_namespace()))
    except ValueError as error:
        raise RuntimeError(str(error)) from error


def topic_types(node: Node, topic: str) -> list[str]:
    """Return the types of a topic; none where nobody publishes or subscribes."""
    return list(dict(node.get_topic_names_and_types()).get(topic, []))


def topic_class(node: Node, topic: str, *, wait: bool) -> Any:
    """Return the message class of a topic.

    :param wait: wait for ever for the topic to appear, rather than for discovery only.
    :raises RuntimeError: if it cannot be told.
    """
    found = wait_for(node, lambda: bool(topic_types(node, topic)), DISCOVERY_S)
    if not found:
        print(f"WARNING: topic [{topic}] does not appear to be published yet")
        if not wait:
            raise RuntimeError("Could not determine the type for the passed topic")
        wait_for(node, lambda: bool(topic_types(node, topic)), float("inf"))
    types = topic_types(node, topic)
    if len(types) > 1:
        raise RuntimeError(
            f"Cannot echo topic '{topic}', as it contains more than one type: [{', '.join(types)}]"
        )
    try:
        return load_class(types[0], "msg")
    except LookupError as error:
        raise RuntimeError(f"The message type '{types[0]}' is invalid") from error


def add_qos_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace the choice of `matching_profile`."""
    parser.add_argument(
        "--qos-profile",
        choices=QoSPresetProfiles.short_keys(),
        default="sensor_data",
        help="Preset profile to subscribe with (default: sensor_data)",
    )
    parser.add_argument("--qos-depth", metavar="N", type=int, help="Queue size")
    parser.add_argument("--qos-history", choices=HistoryPolicy.short_keys())
    parser.add_argument("--qos-reliability", choices=ReliabilityPolicy.short_keys())
    parser.add_argument("--qos-durability", choices=DurabilityPolicy.short_keys())
    parser.add_argument("--qos-liveliness", choices=LivelinessPolicy.short_keys())
    parser.add_argument("--qos-liveliness-lease-duration-seconds", type=float, metavar="S")


def asked_profile(arguments: argparse.Namespace) -> QoSProfile | None:
    """Return the profile that the options ask for; None where they ask for none."""
    given = vars(arguments)
    asked = {
        key.removeprefix("qos_"): given[key]
        for key in given
        if key.startswith("qos_") and key != "qos_profile" and given[key] is not None
    }
    if not asked:
        return None
    profile = QoSPresetProfiles.get_from_short_key(arguments.qos_profile)
    policies = {
        "history": HistoryPolicy,
        "reliability": ReliabilityPolicy,
        "durability": DurabilityPolicy,
        "liveliness": LivelinessPolicy,
    }
    for key, policy in policies.items():
        if key in asked:
            setattr(profile, key, policy.get_from_short_key(asked[key]))
    if "liveliness_lease_duration_seconds" in asked:
        lease = Duration(seconds=asked["liveliness_lease_duration_seconds"])
        profile.liveliness_lease_duration = lease
    if "depth" in asked:
        profile.depth = asked["depth"]
    return profile


def matching_profile(node: Node, topic: str, preset: str) -> QoSProfile:
    """Return the strictest profile that every publisher of ``topic`` can serve."""
    profile = QoSPresetProfiles.get_from_short_key(preset)
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if not offers:
        return profile
    reliable = [offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers]
    latched = [offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers]
    _note_mixture(reliable, "QoSReliabilityPolicy.RELIABLE", "QoSReliabilityPolicy.BEST_EFFORT")
    _note_mixture(latched, "QoSDurabilityPolicy.TRANSIENT_LOCAL", "QoSDurabilityPolicy.VOLATILE")
    profile.reliability = (
        ReliabilityPolicy.RELIABLE if all(reliable) else ReliabilityPolicy.BEST_EFFORT
    )
    profile.durability = (
        DurabilityPolicy.TRANSIENT_LOCAL if all(latched) else DurabilityPolicy.VOLATILE
    )
    return profile


def _note_mixture(offered: list[bool], wanted: str, fallback: str) -> None:
    if any(offered) and not all(offered):
        print(
            f"Some, but not all, publishers are offering {wanted}. Falling back to {fallback} "
            "as it will connect to all publishers"
        )
