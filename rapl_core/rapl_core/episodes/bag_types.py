"""The message types in an episode's bag, without ROS."""

from functools import cache
from importlib.resources import files

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

IMAGE = "sensor_msgs/msg/Image"
JOINT_STATE = "sensor_msgs/msg/JointState"
STATE = "rapl_msgs/msg/State"
ACTION = "rapl_msgs/msg/Action"

OWN_MESSAGES = ("State", "Action")
"""Those of rapl_msgs; ``messages/`` has their definitions, equal to those of the ROS package."""


def message_text(name: str) -> str:
    """Return the definition of a message of rapl_msgs that comes with this package."""
    return (files("rapl_core.episodes") / "messages" / f"{name}.msg").read_text(encoding="utf-8")


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy and our own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in OWN_MESSAGES:
        store.register(get_types_from_msg(message_text(name), f"rapl_msgs/msg/{name}"))
    return store
