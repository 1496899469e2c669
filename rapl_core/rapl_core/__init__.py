"""Representation-aligned preference-based learning: algorithms, worlds, learning; knows no ROS."""

import os

# mujoco reads it when it is imported: without a display only EGL and OSMesa can draw
os.environ.setdefault("MUJOCO_GL", "egl")
