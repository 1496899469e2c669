#!/usr/bin/env bash
# Set up where needed, then run the main job: ./run_all.sh franka_group
# ./run_all.sh --help explains the options, ./run_all.sh --list the tasks.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)

"$here/setup/setup.sh"
# shellcheck source=setup/environment.sh
. "$here/setup/environment.sh"

# The user's domain is honoured; else the run gets one that nobody on this machine uses: Fast DDS
# takes UDP port 7410 + 250 * domain for the first process of a domain. 1 to 101 are safe on Linux.
free_domain() {
  local used candidate offset
  used=$(cat /proc/net/udp /proc/net/udp6 2>/dev/null | awk 'NR > 1 { print toupper($2) }')
  for offset in $(seq 0 100); do
    candidate=$(((RANDOM + offset) % 101 + 1))
    if ! grep -q ":$(printf '%04X' $((7410 + 250 * candidate)))\$" <<<"$used"; then
      echo "$candidate"
      return
    fi
  done
  echo 1
}

if [ -z "${ROS_DOMAIN_ID:-}" ]; then
  ROS_DOMAIN_ID=$(free_domain)
  export ROS_DOMAIN_ID
fi
exec "$rapl_venv/bin/python" -m rapl_ros.run_all "$@"
