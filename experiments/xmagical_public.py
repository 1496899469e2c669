"""Runs the public x-magical package; called by xmagical_parity.py in an environment of its own.

    python experiments/xmagical_public.py ACTIONS.npz OUT.npz

It was written for an older Python and the old gym, of which it uses little: what is missing is put
in place before it is imported. ACTIONS.npz has an array (T, A) for each ``<body>-<sequence>``; for
each, OUT.npz gets ``.../poses`` (T + 1, 3 + 3 * 3 + 2): robot, debris, angles of the fingers, and
``.../pictures`` (T + 1, 112, 112, 3).
"""

import collections
import collections.abc
import os
import sys
import types
from typing import Any

import numpy as np

os.environ["SDL_VIDEODRIVER"] = "dummy"
SIZE = 112


def put_in_place() -> None:
    """Stand in for the gym and the name in collections that the package looks for."""
    collections.Sequence = collections.abc.Sequence  # type: ignore[attr-defined]
    gym, spaces = types.ModuleType("gym"), types.ModuleType("gym.spaces")
    spaces.Box = lambda *args, **options: None  # type: ignore[attr-defined]
    gym.Env = type("Env", (), {})  # type: ignore[attr-defined]
    gym.spaces, gym.register = spaces, lambda *args, **options: None  # type: ignore[attr-defined]
    sys.modules |= {"gym": gym, "gym.spaces": spaces}


def pose(env: Any) -> list[float]:
    """Return robot x, y, angle, the same of each piece of debris, and the fingers' angles."""
    robot = env._robot
    debris = [shape.shape_body for shape in env._SweepToTopEnv__debris_shapes]
    fingers = [body.angle - robot.body.angle for body in getattr(robot, "finger_bodies", [])]
    bodies = [robot.body, *debris]
    return [
        *(value for b in bodies for value in (*b.position, b.angle)), *(fingers or [0.0, 0.0])
    ]  # fmt: skip


def main() -> None:
    """Play every sequence."""
    put_in_place()
    from PIL import Image
    from xmagical.benchmarks.sweep_to_top import SweepToTopEnv
    from xmagical.entities import embodiments

    kinds = {
        "shortstick": embodiments.ShortstickEmbodiment,
        "mediumstick": embodiments.MediumstickEmbodiment,
        "longstick": embodiments.LongstickEmbodiment,
        "gripper": embodiments.NonHolonomicGripperEmbodiment,
    }
    found = {}
    with np.load(sys.argv[1]) as sequences:
        for name in sequences:
            env = SweepToTopEnv(
                robot_cls=kinds[name.split("-")[0]], res_hw=(384, 384), fps=8, phys_steps=10
            )
            pictures, poses = [env.reset()], [pose(env)]
            for action in sequences[name]:
                pictures.append(env.step(action)[0])
                poses.append(pose(env))
            small = [
                Image.fromarray(p).resize((SIZE, SIZE), Image.Resampling.BOX) for p in pictures
            ]
            found[f"{name}/pictures"] = np.stack([np.asarray(p) for p in small])
            found[f"{name}/poses"] = np.array(poses)
    np.savez(sys.argv[2], **found)


if __name__ == "__main__":
    main()
