"""The factor on r* of each task, and how evenly its scripted videos spread r*.

    python experiments/oracle/scales.py [TASK ...]        # writes scales.json, a task at a time

``human_reward_scale`` of a task is what the rule of all rewards, ``fit_scale``, gives for 60
demonstrations of seed 0; a test holds the tasks against the file. Evenness holds the returns of 300
demonstrations against a uniform distribution between the 2nd and 98th percentile: the
Kolmogorov-Smirnov distance (0: uniform), and the shares of the videos in five bands of equal width.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.analysis.provenance import commit, versions
from rapl_core.atomic import write_atomically
from rapl_core.demonstrators import collect
from rapl_core.policies.rewards import fit_scale
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names
from rapl_core.types import Episode

RESULTS = Path(__file__).parent / "scales.json"
SCALED, SEED = 60, 0


def demonstrations(task: str, count: int) -> list[Episode]:
    """Return ``count`` videos of SEED, without their pictures."""
    simulation = Simulation(get_task(task), render=False)
    videos = list(collect(simulation, count, seed=SEED))
    simulation.close()
    return videos


def unevenness(returns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Return the distance from a uniform distribution and the shares of five bands."""
    low, high = np.percentile(returns, [2, 98])
    place = np.sort(np.clip((returns - low) / (high - low), 0, 1))
    steps = np.arange(len(place) + 1) / len(place)
    distance = max(np.abs(place - steps[:-1]).max(), np.abs(place - steps[1:]).max())
    bands = np.histogram(place, bins=5, range=(0, 1))[0] / len(place)
    return float(distance), bands


def scale(task: str) -> float:
    """Return the factor on r* of a task."""
    videos = demonstrations(task, SCALED)
    return fit_scale(v.human_rewards[1:] for v in videos if v.human_rewards is not None)


def spread(task: str, count: int) -> dict[str, object]:
    """Return how ``count`` videos spread r*, and how many succeed."""
    videos = demonstrations(task, count)
    distance, bands = unevenness(np.array([v.human_return for v in videos]))
    return {
        "spread_videos": count,
        "unevenness": round(distance, 2),
        "bands": [round(float(share), 3) for share in bands],
        "success": round(float(np.mean([bool(v.success) for v in videos])), 3),
    }


def main() -> None:
    """Measure task after task; of those not asked for the file keeps what it has."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tasks", nargs="*", help="default: all")
    parser.add_argument("--videos", type=int, default=300, help="for evenness; 0: leave it out")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    begun_at = commit()  # what runs, whatever is committed meanwhile
    for task in options.tasks or task_names():
        row: dict[str, object] = {
            "scale": float(f"{scale(task):.3g}"),
            "scale_videos": SCALED,
            "seed": SEED,
            "commit": begun_at,
            "mujoco": versions()["mujoco"],
        }
        if options.videos:
            row |= spread(task, options.videos)
        known = json.loads(options.out.read_text()) if options.out.is_file() else {}
        rows = dict(sorted((known | {task: row}).items()))
        write_atomically(options.out, json.dumps(rows, indent=1) + "\n")
        print(task, row, flush=True)


if __name__ == "__main__":
    main()
