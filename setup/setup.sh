#!/usr/bin/env bash
# Make .venv with all that RAPL needs. Safe to repeat: finished parts are recognised by a hash of
# their inputs, an interrupted part is done again. Output of the parts goes to build/setup.log.
#
# With a sourced ROS 2 Jazzy its rclpy and message generators are used (colcon build in ros_ws);
# without one, ROS comes from Python wheels and rapl_msgs is built into .venv.
#
# RAPL_PYTHON names the Python to use (3.11 to 3.13).
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(dirname "$here")
venv=$root/.venv
stamps=$venv/rapl-setup
log=$root/build/setup.log
child=

say() { printf 'set-up: %s\n' "$*"; }

fail() {
  printf 'set-up failed: %s\n' "$*" >&2
  exit 1
}

stop() {
  [ -z "$child" ] || kill -TERM -- "-$child" 2>/dev/null || true
  printf '\nset-up interrupted; start it again to go on\n' >&2
  exit 130
}

# step TITLE COMMAND...: run it with its output in the log, show the time it takes.
step() {
  local title=$1 start=$SECONDS status=0
  shift
  printf 'set-up: %s ...' "$title"
  printf '\n=== %s\n' "$title" >>"$log"
  set -m
  "$@" >>"$log" 2>&1 </dev/null &
  child=$!
  set +m
  while [ -t 1 ] && kill -0 "$child" 2>/dev/null; do
    printf '\rset-up: %s ... %d s' "$title" $((SECONDS - start))
    sleep 0.5
  done
  wait "$child" || status=$?
  child=
  if [ "$status" -ne 0 ]; then
    printf ' failed\n'
    tail -n 15 "$log" >&2
    fail "$title (all output: $log)"
  fi
  [ ! -t 1 ] || printf '\rset-up: %s ...' "$title"
  printf ' %d s, done\n' $((SECONDS - start))
}

# digest TEXT FILE...: one hash of a text and of the named files, wherever the checkout lies.
digest() {
  local text=$1
  shift
  { printf '%s\n' "$text"; cat -- "$@" </dev/null; } | sha256sum | cut -c1-16
}

is_done() { [ "$(cat "$stamps/$1" 2>/dev/null || true)" = "$2" ]; }

mark_done() {
  printf '%s\n' "$2" >"$stamps/$1.new"
  mv "$stamps/$1.new" "$stamps/$1"
}

find_python() {
  local candidate candidates=(python3 python3.12 python3.11 python3.13)
  if [ -n "${RAPL_PYTHON:-}" ]; then
    candidates=("$RAPL_PYTHON")
  elif [ "$ros" = jazzy ]; then
    candidates=(/usr/bin/python3)
  fi
  for candidate in "${candidates[@]}"; do
    if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
      2>/dev/null; then
      "$candidate" -c 'import sys; print(getattr(sys, "_base_executable", sys.executable))'
      return
    fi
  done
  return 1
}

# The newest suitable Python among the packages that this machine's apt knows.
debian_python() {
  local version
  if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    apt-get update >>"$log" 2>&1 || true
  fi
  for version in 3.12 3.13 3.11; do
    if apt-cache show "python$version-venv" >/dev/null 2>&1; then
      echo "python$version" "python$version-venv" "python$version-dev"
      return
    fi
  done
  echo python3.11 python3.11-venv python3.11-dev
}

install_debian_packages() {
  local command="apt-get update; apt-get install --yes --no-install-recommends $*"
  if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    step "system packages $*" bash -c "$command"
  else
    fail "missing system packages. Install them with: sudo sh -c '$command'"
  fi
}

check_system() {
  local found missing
  found=$("$python" "$here/system_check.py")
  missing=$(sed -n 2p <<<"$found")
  if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    install_debian_packages $missing
    found=$("$python" "$here/system_check.py")
    missing=$(sed -n 2p <<<"$found")
    [ -z "$missing" ] || fail "still missing after their installation: $missing"
  fi
  gl=$(sed -n 1p <<<"$found")
}

make_venv() {
  local option=()
  [ "$ros" = wheels ] || option=(--system-site-packages)
  rm -rf "$venv"
  "$python" -m venv "${option[@]}" "$venv"
}

install_packages() {
  local lock=$venv/requirements.lock
  cp "$here/requirements.lock" "$lock"
  if [ "$ros" = jazzy ]; then # the sourced Jazzy has its own
    grep -vE '^(ros-|catkin-pkg|empy|lark-parser)' "$here/requirements.lock" >"$lock"
  fi
  "$venv/bin/python" -m pip install --no-deps --no-input --progress-bar off -r "$lock"
  if [ "$ros" = jazzy ] && ! "$venv/bin/python" -c 'import colcon_core' 2>/dev/null; then
    "$venv/bin/python" -m pip install --no-input --progress-bar off colcon-common-extensions
  fi
}

install_own_packages() {
  "$venv/bin/python" -m pip install --no-input --no-deps --no-build-isolation \
    -e "$root/rapl_core" -e "$root/rapl_ros"
  mkdir -p "$venv/standin/bin"
  sed "s|@VENV@|$venv|" "$here/ros2_standin.sh" >"$venv/standin/bin/ros2"
  chmod +x "$venv/standin/bin/ros2"
}

build_interfaces() {
  if [ "$ros" = wheels ]; then
    "$here/build_messages.sh" "$venv"
  else
    cd "$root/ros_ws"
    "$venv/bin/python" -m colcon build --symlink-install \
      --cmake-args -DPython3_EXECUTABLE="$venv/bin/python"
  fi
}

refresh() { # refresh STAMP HASH TITLE COMMAND...
  local stamp=$1 hash=$2
  shift 2
  is_done "$stamp" "$hash" && return
  rm -f "$stamps/$stamp"
  step "$@"
  mark_done "$stamp" "$hash"
}

set_up() {
  local interfaces place packages own generators built
  ros=wheels
  if [ "${ROS_DISTRO:-}" = jazzy ] && /usr/bin/python3 -c 'import rclpy' 2>/dev/null; then
    ros=jazzy
  fi
  mapfile -t interfaces < <(find "$root/ros_ws/src/rapl_msgs" -type f | LC_ALL=C sort)
  place=$(digest "$ros $venv")
  packages=$(digest "$place" "$here/requirements.lock")
  own=$(digest "$packages $(cd "$root/rapl_ros" && echo rapl_ros/*_node.py)" \
    "$root"/rapl_{core,ros}/setup.{py,cfg} "$here/ros2_standin.sh")
  generators=$(grep -E '^(ros-|catkin-pkg|empy|lark-parser|numpy)' "$here/requirements.lock")
  built=$(digest "$place $generators" "${interfaces[@]}" "$here"/build_messages.sh "$here"/*.cmake)
  if is_done place "$place" && is_done packages "$packages" && is_done own "$own" &&
    is_done interfaces "$built"; then
    return
  fi
  : >"$log"
  if ! python=$(find_python); then
    [ -z "${RAPL_PYTHON:-}" ] || fail "RAPL_PYTHON=$RAPL_PYTHON is no Python 3.11, 3.12 or 3.13"
    say "no Python 3.11, 3.12 or 3.13 found"
    install_debian_packages "$(debian_python)"
    python=$(find_python) || fail "still none; name one: RAPL_PYTHON=/path/to/python3.12"
  fi
  if [ "$ros" = jazzy ]; then
    say "using the ROS 2 Jazzy that is sourced, $python"
  else
    say "no ROS 2 Jazzy is sourced: ROS comes from Python wheels, $python"
  fi
  check_system
  if ! is_done place "$place" || [ ! -f "$stamps/packages" ]; then # moved, or interrupted
    step "virtual environment" make_venv
    mkdir -p "$stamps"
    mark_done place "$place"
  fi
  printf '%s\n' "$gl" >"$stamps/gl"
  refresh packages "$packages" "Python packages (some 3 GB, the first time)" install_packages
  refresh own "$own" "rapl_core and rapl_ros" install_own_packages
  refresh interfaces "$built" "messages" build_interfaces
  say "finished in $SECONDS s"
}

mkdir -p "$root/build"
exec 9>"$root/build/setup.lock"
if ! flock --nonblock 9; then
  say "another set-up is at work here, waiting for it"
  flock 9
fi
trap stop INT TERM HUP
set_up
