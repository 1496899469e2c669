"""The commands of ``ros2 run rapl_ros``: one per module ``*_node``."""

import runpy
import sys
from pathlib import Path


def run() -> None:
    """Run the node whose name this command has."""
    name = Path(sys.argv[0]).name
    runpy.run_module(f"rapl_ros.{name}_node", run_name="__main__", alter_sys=True)
