"""What a result was made with: versions, commit, machine."""

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "rapl_core",
    "rapl_ros",
    "numpy",
    "torch",
    "torchvision",
    "timm",
    "mujoco",
    "stable-baselines3",
    "pot",
    "rosbags",
    "ros-jazzy-rclpy",
)


def versions() -> dict[str, str]:
    """Return the version of Python and of each package that matters and is installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def commit(folder: Path | None = None) -> str:
    """Return the commit of the source tree, ``-modified`` when it has changes; empty if unknown.

    :param folder: inside the tree; None: where this package lies.
    """
    where = folder or Path(__file__).resolve().parent
    try:
        head = _git(where, "rev-parse", "HEAD")
        changed = _git(where, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return ""
    return head + ("-modified" if changed else "")


def machine() -> dict[str, str]:
    """Return processor, cores, memory and system; nothing that identifies the machine."""
    return {
        "processor": _processor(),
        "cores": str(_cores()),
        "memory": f"{_memory_gib():.0f} GiB",
        "system": f"{platform.system()} {platform.release()}",
    }


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments],
        capture_output=True,
        text=True,
        timeout=10,
        check=True,
    )
    return done.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _memory_gib() -> float:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (ValueError, OSError):
        return float("nan")
