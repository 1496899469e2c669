"""A node without work, for tests of what every node has: ``python -m lonely_node``."""

import sys

from rapl_core.errors import RaplError
from rapl_ros.node import RaplNode, main


class Lonely(RaplNode):
    """Says when it is closed; fails on request."""

    def __init__(self) -> None:
        super().__init__("encoder")
        self.declare_parameter("fault", "")
        fault = self.get_parameter("fault").value
        if fault == "refuses":
            raise RaplError("there is nothing to encode")
        if fault == "breaks":
            self.steady_timer(0.1, lambda: 1 // 0)
        self.heartbeat.report("active", "doing nothing")

    def close(self) -> None:
        print("closed", file=sys.stderr)


if __name__ == "__main__":
    main(Lonely)
