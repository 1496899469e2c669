"""How another terminal gets a ``ros2`` that sees this run."""

import os
import shlex
import sys
from pathlib import Path

VARIABLES = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")


def standin_folder() -> Path:
    """Return the folder that holds the stand-in's ``ros2``."""
    return Path(sys.prefix) / "standin" / "bin"


def real_ros2() -> Path | None:
    """Return the first ``ros2`` on PATH that is not the stand-in."""
    for entry in os.environ.get("PATH", "").split(os.pathsep):
        candidate = Path(entry) / "ros2"
        if entry and os.access(candidate, os.X_OK) and candidate.parent != standin_folder():
            return candidate
    return None


def shell_line() -> str:
    """Return the line that a person pastes into another terminal (bash or zsh) to use ``ros2``."""
    settings = [
        f"{name}={shlex.quote(os.environ[name])}" for name in VARIABLES if name in os.environ
    ]
    overlay = _overlay()
    if real_ros2() is None:
        settings.insert(0, f'PATH={shlex.quote(str(standin_folder()))}:"$PATH"')
    elif overlay is not None:
        return f"source {shlex.quote(str(overlay))} && export {' '.join(settings)}"
    return f"export {' '.join(settings)}"


def _overlay() -> Path | None:
    """Return the set-up file of the colcon workspace that holds rapl_msgs, if it is in use."""
    for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        script = Path(entry).parent / "local_setup.bash"
        if Path(entry).name == "rapl_msgs" and script.is_file():
            return script
    return None
