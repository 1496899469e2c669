#!/usr/bin/env bash
# Set up where needed, then run the main job: ./run_all.sh franka_group
# ./run_all.sh --help explains the options, ./run_all.sh --list the tasks.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)

if [ ! -x "$here/.venv/bin/python" ]; then # a question or a slip must not fetch gigabytes
  if [ $# -eq 0 ]; then
    echo "./run_all.sh: a task is missing; ./run_all.sh --list names them" >&2
    exit 2
  fi
  for argument in "$@"; do
    name=${argument%%=*}
    case $name in
      -h | --help) exec cat "$here/setup/help.txt" ;;
      --list) exec cat "$here/setup/list.txt" ;;
      -*)
        grep -qE -- "(^|[ [])$name([], ]|$)" "$here/setup/help.txt" && continue
        echo "./run_all.sh: unrecognized argument: $name; ./run_all.sh --help explains all" >&2
        exit 2
        ;;
    esac
  done
fi
"$here/setup/setup.sh"
# shellcheck source=setup/environment.sh
. "$here/setup/environment.sh"
exec "$rapl_venv/bin/python" -m rapl_ros.run_all "$@"
