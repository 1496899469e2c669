"""``python -m rapl_core.cli``."""

import sys

from rapl_core.cli import main

if __name__ == "__main__":
    sys.exit(main())
