"""A ROS domain for each test module, and for each test that kills nodes.

A node that is killed stays visible in its domain for up to 20 s: services look ready, goals go to
nobody. In a domain of its own no test meets the ghosts of another.
"""

import itertools
import os
import random
from typing import Final

from rapl_ros.domain import DOMAINS, is_free

_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_mine: Final = list(DOMAINS)[_worker::_workers]
_first: Final = random.randrange(len(_mine))
_next = itertools.cycle(_mine[_first:] + _mine[:_first])
"""Each once before any comes again; no two workers of pytest-xdist share one."""


def enter_own_domain() -> int:
    """Let ROS_DOMAIN_ID be a domain in which nobody is, for this process and those it starts."""
    domain = next(domain for domain in itertools.islice(_next, len(_mine)) if is_free(domain))
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    return domain
