#!/usr/bin/env bash
# `ros2` for machines without one. A real ros2 further on in PATH takes over.
self=$(readlink -f "${BASH_SOURCE[0]}")
while IFS= read -r other; do
  if [ "$(readlink -f "$other")" != "$self" ]; then
    exec "$other" "$@"
  fi
done < <(type -ap ros2)
exec "@VENV@/bin/python" -m rapl_ros.ros2_standin "$@"
