#!/usr/bin/env bash
# Build rapl_msgs with the ROS 2 wheels of a virtual environment and install it into that one.
# Usage: build_messages.sh VENV
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(dirname "$here")
venv=$(cd "$1" && pwd)
build="$root/build/rapl_msgs"
python=$venv/bin/python

export PATH="$venv/bin:$PATH"
rm -rf "$build"
cmake -S "$root/ros_ws/src/rapl_msgs" -B "$build" -GNinja \
  -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
  -DCMAKE_PREFIX_PATH="$venv" -DCMAKE_INSTALL_PREFIX="$venv" \
  -DPython3_EXECUTABLE="$python" -DCMAKE_PROJECT_INCLUDE="$here/wheel_targets.cmake"
cmake --build "$build" -j "$(nproc)"
cmake --install "$build"
"$python" -c "import rapl_msgs.action, rapl_msgs.msg, rapl_msgs.srv"
