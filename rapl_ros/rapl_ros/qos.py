"""Every QoS profile with its reason.

Functions, because an override by parameter changes the profile that it is given.
"""

from typing import Final

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

LEASE_S: Final = 2.0
"""Silence after which a node counts as gone. Without a lease a killed process stays for 20 s."""

STREAM_DEPTH: Final = 4096
"""Messages. KEEP_LAST loses silently, so it holds three episodes of all worlds (`stream_depth`)."""


def stream_depth(worlds: int, horizon: int) -> int:
    """Messages in three episodes of all worlds: what back-pressure lets accumulate at most.

    A controller stops at two unanswered episodes a world; the third is the one under way.
    """
    return 3 * worlds * (horizon + 1)


def stream(depth: int = STREAM_DEPTH) -> QoSProfile:
    """Image, state, action, embedding, joint states: none may be lost, late joiners need none."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE
    )


def event() -> QoSProfile:
    """Reward, episode, metrics: few, each counts; the past is on disk."""
    return stream(depth=1000)


def progress() -> QoSProfile:
    """Who joins late, such as the terminal of a resumed run, sees the stages that went before."""
    profile = stream(depth=50)
    profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return profile


def latched() -> QoSProfile:
    """World, encoder, expert set, policy: whoever joins late gets the newest one."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def clock() -> QoSProfile:
    """Only the newest time matters; reliable, since subscribers choose best effort themselves."""
    return stream(depth=1)


def heartbeat() -> QoSProfile:
    """Latched, so that a peer's name is known at once; the lease is kept by the middleware's own
    thread, so that a node in a long callback is alive and a killed one is not."""
    profile = latched()
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(seconds=LEASE_S)
    return profile


def diagnostics() -> QoSProfile:
    """As diagnostic_updater has it."""
    return stream(depth=10)


def preview() -> QoSProfile:
    """A picture for people to look at: only the newest, from any camera, and never at the cost of
    whoever waits for all of them."""
    profile = stream(depth=1)
    profile.reliability = ReliabilityPolicy.BEST_EFFORT
    return profile


def overrides() -> QoSOverridingOptions:
    """Lets parameters ``qos_overrides.<topic>.subscription.*`` fit a profile to a foreign
    publisher: camera drivers are best effort, and a reliable subscription gets nothing from them.
    """
    return QoSOverridingOptions(
        policy_kinds=(
            QoSPolicyKind.HISTORY,
            QoSPolicyKind.DEPTH,
            QoSPolicyKind.RELIABILITY,
            QoSPolicyKind.DURABILITY,
        )
    )
