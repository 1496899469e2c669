"""How near the X-MAGICAL worlds are to the public package: pictures, and motion.

    python experiments/xmagical_parity.py     # makes its environment in runs/ once

The public package runs in an environment of its own (``xmagical_public.py``). Both play the same
actions from the same start, of random driving and of scripted sweeps. Pictures are compared where
the public one's poses are put into ours; motion by how far robot and debris are apart after 1 s,
5 s and at the end. Writes xmagical_parity.json and .png beside this file.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.demonstrators import make_demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task
from rapl_core.tasks.xmagical_bodies import BODIES

HERE = Path(__file__).parent
PACKAGES = ("x-magical==0.0.4", "pymunk~=5.6.0", "pygame", "numpy", "Pillow", "setuptools")
STEPS_A_SECOND = 8
SHOWN = ("shortstick-sweep0", "mediumstick-drive0", "longstick-sweep0", "gripper-sweep0")


@dataclass(frozen=True)
class Parity:
    """One sequence in both worlds."""

    name: str
    difference: float
    """Mean absolute difference of pictures at equal poses, of 1."""
    differing: float
    """Share of pixels that differ by more than a tenth in some channel."""
    robot_m: tuple[float, float, float]
    """How far the robots are apart after 1 s, 5 s and at the end."""
    debris_m: tuple[float, float, float]
    """The same of the debris, the mean of three."""


def public_python(folder: Path) -> Path:
    """Return the interpreter of the public package's environment, made if it is not there."""
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        pip = [str(python), "-m", "pip", "install", "-q"]
        subprocess.run([*pip, *PACKAGES[1:]], check=True)
        subprocess.run([*pip, "--no-deps", PACKAGES[0]], check=True)  # not the old gym
    return python


def play(simulation: Simulation, actions: NDArray[np.float64] | str) -> tuple[NDArray, NDArray]:
    """Return actions (T, A) and poses (T + 1, 12) of an episode.

    :param actions: what to do, or the name of a behaviour.
    """
    task = simulation.task
    snapshot = simulation.reset(0, episode_rng(0, "test", 0, 0))
    demonstrator = None
    if isinstance(actions, str):
        demonstrator = make_demonstrator(task, actions, np.random.default_rng(0))
    taken, poses = [], [pose(simulation)]
    while not snapshot.is_last:
        if demonstrator is not None:
            action = demonstrator.act(snapshot.state, snapshot.step)
        else:
            action = actions[snapshot.step]
        snapshot = simulation.step(0, action)
        taken.append(action)
        poses.append(pose(simulation))
    return np.stack(taken), np.stack(poses)


def joints(simulation: Simulation) -> NDArray[np.intp]:
    """Return the addresses of robot (3) and debris (9) in qpos."""
    names = [f"{b}_{axis}" for b in ("robot", "block1", "block2", "block3")
             for axis in ("x", "y", "yaw")]  # fmt: skip
    return np.array([simulation.model.joint(name).qposadr[0] for name in names])


def pose(simulation: Simulation) -> NDArray[np.float64]:
    """Return x, y and angle of robot and debris (12,)."""
    return simulation.data[0].qpos[joints(simulation)].copy()


def draw(simulation: Simulation, public_pose: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return our picture of a pose of the public package (14,)."""
    import mujoco  # after rapl_core, which says how it draws

    data = simulation.data[0]
    data.qpos[joints(simulation)] = public_pose[:12]
    if simulation.task.name.endswith("gripper"):
        for name, angle in zip(("left_finger", "right_finger"), public_pose[12:], strict=True):
            data.qpos[simulation.model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(simulation.model, data)
    return simulation.render(0)


def sequences(simulation: Simulation, count: int) -> dict[str, tuple[NDArray, NDArray]]:
    """Return actions and our poses: smooth random driving, and scripted sweeps."""
    task = simulation.task
    found = {}
    for index in range(count):
        rng = np.random.default_rng(index)
        knots = rng.uniform(-1, 1, (task.horizon // 5 + 1, len(task.action_names)))
        knots[:, 0] = np.abs(knots[:, 0]) * rng.choice([1, 1, 1, -1])
        knots[:, 1] *= rng.choice([0.0, 0.02, 1.0], len(knots))  # ahead, gently, sharply
        found[f"drive{index}"] = play(simulation, np.repeat(knots, 5, axis=0)[: task.horizon])
    for index, behaviour in enumerate(("sweep_all", "sweep_one")):
        found[f"sweep{index}"] = play(simulation, behaviour)
    return found


def compare(name: str, ours: NDArray, theirs: NDArray, pictures: NDArray, drawn: NDArray) -> Parity:
    """Return how near a sequence is.

    :param ours: poses (T + 1, 12); theirs (T + 1, 14).
    :param pictures: the public ones (T + 1, 112, 112, 3); drawn: ours at the same poses.
    """
    apart = (ours - theirs[:, :12]).reshape(len(ours), 4, 3)[..., :2]
    distance = np.linalg.norm(apart, axis=-1)  # (T + 1, 4)
    moments = [STEPS_A_SECOND, 5 * STEPS_A_SECOND, len(ours) - 1]
    difference = np.abs(pictures.astype(float) - drawn) / 255
    return Parity(
        name,
        float(difference.mean()),
        float((difference.max(axis=-1) > 0.1).mean()),
        tuple(float(distance[m, 0]) for m in moments),
        tuple(float(distance[m, 1:].mean()) for m in moments),
    )


def main() -> None:
    """Play, compare, and write results and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environment", type=Path, default=Path("runs/x-magical-environment"))
    parser.add_argument("--sequences", type=int, default=3, help="of random driving, a body")
    options = parser.parse_args()
    python = public_python(options.environment)
    work = options.environment / "actions.npz", options.environment / "public.npz"
    simulations = {
        body: Simulation(get_task(f"xmagical_sweep_{body}"), render=False) for body in BODIES
    }
    played = {
        f"{body}-{name}": result
        for body, simulation in simulations.items()
        for name, result in sequences(simulation, options.sequences).items()
    }
    np.savez(work[0], **{name: actions for name, (actions, _) in played.items()})
    subprocess.run([str(python), str(HERE / "xmagical_public.py"), *map(str, work)], check=True)
    found, rows = [], []
    with np.load(work[1]) as public:
        for body in BODIES:
            simulation = Simulation(get_task(f"xmagical_sweep_{body}"))
            for name, (_, ours) in played.items():
                if not name.startswith(f"{body}-"):
                    continue
                theirs, pictures = public[f"{name}/poses"], public[f"{name}/pictures"]
                drawn = np.stack([draw(simulation, pose) for pose in theirs])
                found.append(compare(name, ours, theirs, pictures, drawn))
                print(found[-1], flush=True)
                if name in SHOWN:
                    for shown in (pictures, drawn):
                        chosen = np.linspace(0, len(shown) - 1, 8).round().astype(int)
                        rows.append(np.hstack([np.pad(shown[i], ((2, 2), (2, 2), (0, 0)))
                                               for i in chosen]))  # fmt: skip
            simulation.close()
    result = {
        "sequences": [asdict(parity) for parity in found],
        "picture_difference": float(np.mean([parity.difference for parity in found])),
        "pixels_differing": float(np.mean([parity.differing for parity in found])),
        "robot_m_median": np.median([parity.robot_m for parity in found], axis=0).tolist(),
        "debris_m_median": np.median([parity.debris_m for parity in found], axis=0).tolist(),
        "commit": commit(),
        "machine": machine(),
        "versions": versions(),
    }
    (HERE / "xmagical_parity.json").write_text(json.dumps(result, indent=1, default=str) + "\n")
    Image.fromarray(np.vstack(rows)).save(HERE / "xmagical_parity.png", optimize=True)


if __name__ == "__main__":
    main()
