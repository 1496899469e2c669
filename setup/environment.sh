# shellcheck shell=bash
# Sourced by run_all.sh and the Makefile, from anywhere: what every RAPL process needs.
# Honours what the user has set.
rapl_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
rapl_venv=$rapl_root/.venv

if [ -f "$rapl_root/ros_ws/install/local_setup.bash" ] && [ "${ROS_DISTRO:-}" = jazzy ]; then
  set +u # colcon's scripts read unset variables
  . "$rapl_root/ros_ws/install/local_setup.bash"
  set -u
elif [ -n "${ROS_DISTRO:-}" ]; then # another ROS is sourced: its Python must not shadow the wheels
  unset PYTHONPATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH ROS_DISTRO
  LD_LIBRARY_PATH=$(printf %s "${LD_LIBRARY_PATH:-}" | tr : '\n' | grep -v '^/opt/ros/' |
    paste -sd: || true)
  export LD_LIBRARY_PATH
fi

export PATH="$rapl_venv/bin:$PATH"
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
if [ -z "${MUJOCO_GL:-}" ]; then
  MUJOCO_GL=$(cat "$rapl_venv/rapl-setup/gl" 2>/dev/null || echo egl)
  export MUJOCO_GL
fi
