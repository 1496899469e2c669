"""Pictures a second, physics included, of every task; beside it the same scene as it was modelled.

    python experiments/benchmark_rendering.py            # writes experiments/results/rendering.json

Each task is stepped with random actions and drawn after every step, 112 x 112, software GL, in one
process. Then once more with the robot's original meshes instead of the decimated ones, in the same
run, so that the ratio holds on any machine. Planar worlds have no meshes: they are measured once.
Runs of the two kinds alternate, and the median of ``--repeats`` is what counts: other work on the
machine slows single ones.
"""

import argparse
import json
import os
import time
from pathlib import Path
from statistics import median

import numpy as np

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.simulation.meshes import drawn_triangles
from rapl_core.simulation.simulation import VISUAL_GROUP, Simulation, episode_rng
from rapl_core.tasks import get_task, task_names

RESULTS = Path(__file__).parent / "results" / "rendering.json"
SLOW_FRAMES = 20
"""Drawn with original meshes: some twenty pictures a second are enough to tell the rate."""


def frames_per_s(simulation: Simulation, frames: int, seed: int) -> tuple[float, float]:
    """Step and draw ``frames`` times; return frames a second of wall time and of this process."""
    rng = np.random.default_rng(seed)
    size = len(simulation.task.action_names)
    snapshot = simulation.reset(0, episode_rng(seed, "test", 0, 0))
    simulation.render(0)  # the first picture loads what the driver needs
    wall_s = cpu_s = 0.0
    for number in range(frames):
        if snapshot.is_last:
            snapshot = simulation.reset(0, episode_rng(seed, "test", 0, number))
        wall, cpu = time.perf_counter(), time.process_time()
        snapshot = simulation.step(0, rng.uniform(-1, 1, size))
        simulation.render(0)
        wall_s += time.perf_counter() - wall
        cpu_s += time.process_time() - cpu
    return frames / wall_s, frames / cpu_s


def measure(name: str, frames: int, repeats: int) -> dict[str, object]:
    """Return the figures of one task."""
    task = get_task(name)
    kinds = {"decimated": Simulation(task)}
    if task.visual_triangles:
        kinds["original"] = Simulation(task, full_meshes=True)
    rates: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for repeat in range(repeats):
        for kind, simulation in kinds.items():
            drawn = frames if kind == "decimated" else SLOW_FRAMES
            rates[kind].append(frames_per_s(simulation, drawn, repeat))
    row: dict[str, object] = {"task": name}
    for kind, simulation in kinds.items():
        row[f"{kind}_triangles"] = drawn_triangles(simulation.model, VISUAL_GROUP)
        row[f"{kind}_frames_per_s"] = round(median(wall for wall, _ in rates[kind]), 1)
        row[f"{kind}_frames_per_cpu_s"] = round(median(cpu for _, cpu in rates[kind]), 1)
        simulation.close()
    return row


def main() -> None:
    """Measure every task and write the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tasks", nargs="*", default=task_names())
    parser.add_argument("--frames", type=int, default=120, help="drawn each time (%(default)s)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    load_before = os.getloadavg()[0]
    began = time.monotonic()
    rows = []
    for name in options.tasks:
        rows.append(measure(name, options.frames, options.repeats))
        print(rows[-1], flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    result = {
        "size": 112,
        "rows": rows,
        "frames": options.frames,
        "repeats": options.repeats,
        "load_before": load_before,
        "load_after": os.getloadavg()[0],
        "wall_s": round(time.monotonic() - began, 1),
        "commit": commit(),
        "machine": machine(),
        "versions": versions(),
    }
    options.out.write_text(json.dumps(result, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
