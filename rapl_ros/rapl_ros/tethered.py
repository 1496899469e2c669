"""Run a node's module so that it cannot outlive the supervisor that started it.

``python -m rapl_ros.tethered PARENT_PID MODULE [ARGUMENT ...]``: the kernel kills this process
when its parent dies, however the parent dies; no orphan keeps a domain or a GPU busy.
"""

import ctypes
import gc
import os
import runpy
import signal
import sys
from typing import NoReturn

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Tie this process to its parent, then become the module."""
    parent, module, *arguments = sys.argv[1:]
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != int(parent):  # it died before the request above took effect
        raise SystemExit(1)
    sys.argv = [module, *arguments]
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as ending:
        code = ending.code
    else:
        code = 0
    _leave(code)


def _leave(code: object) -> NoReturn:
    """End the process without taking the interpreter apart: with torch in it that is seconds."""
    if code is not None and not isinstance(code, int):
        print(code, file=sys.stderr)
        code = 1
    gc.collect()  # middleware objects that nobody holds free their shared memory
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)


if __name__ == "__main__":
    main()
