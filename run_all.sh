#!/usr/bin/env bash
# Set up where needed, then run the main job: ./run_all.sh franka_group
# ./run_all.sh --help explains the options, ./run_all.sh --list the tasks.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)

"$here/setup/setup.sh"
# shellcheck source=setup/environment.sh
. "$here/setup/environment.sh"
exec "$rapl_venv/bin/python" -m rapl_ros.run_all "$@"
