"""Where a run's graph lives: a ROS domain of its own on this machine, unless the user says more."""

import os
import random
import socket
from collections.abc import Mapping
from pathlib import Path

from rapl_core.errors import RaplError

DOMAINS = range(1, 102)
"""Safe on Linux: above, the ports reach into the ephemeral range."""

DISCOVERY_RANGE = "LOCALHOST"
"""How far nodes look for each other unless the user says; ROS's own default is the whole subnet."""

PARTICIPANTS = 32
"""Processes of a domain on one machine that find each other where discovery is LOCALHOST."""


def graph_environment(folder: Path, environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return what every process of a run needs in its environment; what is set already stays.

    :param folder: of the run.
    :param environment: what is set; None: this process's own.
    """
    given = os.environ if environment is None else environment
    return {
        "ROS_DOMAIN_ID": given.get("ROS_DOMAIN_ID") or str(free_domain()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": given.get(
            "ROS_AUTOMATIC_DISCOVERY_RANGE", DISCOVERY_RANGE
        ),
        # Several threads a process on a busy machine are slower than one.
        "OMP_NUM_THREADS": given.get("OMP_NUM_THREADS", "1"),
        "ROS_LOG_DIR": given.get("ROS_LOG_DIR", str((folder / "logs" / "ros").resolve())),
        "PYTHONUNBUFFERED": "1",
    }


def free_domain() -> int:
    """Return a domain in which nobody on this machine is, at random among those.

    :raises RaplError: if all are taken.
    """
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if is_free(domain):
            return domain
    raise RaplError("every ROS domain from 1 to 101 is in use on this machine; set ROS_DOMAIN_ID")


def is_free(domain: int) -> bool:
    """Whether no process on this machine is in ``domain``.

    Fast DDS binds UDP port 7410 + 250 * domain + 2 * n for the n-th process of a domain; the
    first one may have left while others are still there.
    """
    for participant in range(PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7410 + 250 * domain + 2 * participant))
            except OSError:
                return False
    return True
