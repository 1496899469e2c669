#!/usr/bin/env bash
# Build rapl_msgs with the ROS 2 wheels of a virtual environment and install it into that one.
# Usage: build_messages.sh VENV
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(dirname "$here")
venv=$(cd "$1" && pwd)
build=$venv/rapl-setup/build/rapl_msgs
manifest=$build/install_manifest.txt
installed=$venv/rapl-setup/rapl_msgs.manifest

export PATH="$venv/bin:$PATH"
rm -rf "$build"
cmake -S "$root/ros_ws/src/rapl_msgs" -B "$build" -GNinja \
  -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
  -DCMAKE_PREFIX_PATH="$venv" -DCMAKE_INSTALL_PREFIX="$venv" \
  -DPython3_EXECUTABLE="$venv/bin/python" -DCMAKE_PROJECT_INCLUDE="$here/wheel_targets.cmake"
cmake --build "$build" -j "$(nproc)"
cmake --install "$build"
if [ -f "$installed" ]; then # what an older version installed and this one does not
  LC_ALL=C comm -23 <(LC_ALL=C sort "$installed") <(LC_ALL=C sort "$manifest") |
    while IFS= read -r file; do rm -f -- "$file"; done
fi
cp "$manifest" "$installed"
rm -rf "$build"
"$venv/bin/python" -c "import rapl_msgs.action, rapl_msgs.msg, rapl_msgs.srv"
