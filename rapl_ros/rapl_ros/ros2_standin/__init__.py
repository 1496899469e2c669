"""``ros2`` for machines that have no ros2cli: the verbs with which one watches and steers a run.

Same verbs, arguments and output as the real one has for them; it keeps no daemon and says in
``--version`` what it is.
"""

from typing import Final

VERSION: Final = "0.1.0"
