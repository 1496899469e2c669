"""The message types in an episode's bag, without ROS.

Those that ROS does not bring come with this package as definitions: ``messages/<package>/msg/
<Name>.msg``. What they are called is told by where they lie, and by nothing here.
"""

from functools import cache
from importlib.resources import as_file, files

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

IMAGE = "sensor_msgs/msg/Image"
JOINT_STATE = "sensor_msgs/msg/JointState"


@cache
def definitions() -> dict[str, str]:
    """Return the definitions that come with this package, by the name of their type."""
    with as_file(files("rapl_core.episodes") / "messages") as folder:
        return {
            file.relative_to(folder).with_suffix("").as_posix(): file.read_text(encoding="utf-8")
            for file in sorted(folder.glob("*/msg/*.msg"))
        }


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy and those defined here."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in definitions().items():
        store.register(get_types_from_msg(text, name))
    return store


def _defined(name: str) -> str:
    """Return the full name of the type that is called ``name``."""
    (found,) = (full for full in definitions() if full.endswith(f"/{name}"))
    return found


STATE = _defined("State")
ACTION = _defined("Action")
