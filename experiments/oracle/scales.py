"""The factor on r* of each task, and how evenly its scripted videos spread r*.

    python experiments/oracle/scales.py [TASK ...]

``human_reward_scale`` of a task is what the rule of all rewards, ``fit_scale``, gives for 60
demonstrations of seed 0. Evenness holds the returns of 300 demonstrations against a uniform
distribution between the 2nd and 98th percentile: the Kolmogorov-Smirnov distance (0: uniform), and
the shares of the videos in five bands of equal width.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

from rapl_core.demonstrators import collect
from rapl_core.policies.rewards import fit_scale
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names
from rapl_core.types import Episode


def demonstrations(task: str, count: int) -> list[Episode]:
    """Return ``count`` videos of seed 0, without their pictures."""
    simulation = Simulation(get_task(task), render=False)
    videos = list(collect(simulation, count, seed=0))
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


def main() -> None:
    """Print one line a task."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", help="default: all")
    parser.add_argument("--videos", type=int, default=300)
    options = parser.parse_args()
    for task in options.tasks or task_names():
        sixty = [
            v.human_rewards[1:] for v in demonstrations(task, 60) if v.human_rewards is not None
        ]
        videos = demonstrations(task, options.videos)
        distance, bands = unevenness(np.array([v.human_return for v in videos]))
        shares = " ".join(f"{share:.0%}" for share in bands)
        print(
            f"{task}: scale {fit_scale(sixty):.3g}, unevenness {distance:.2f}, bands {shares}, "
            f"success {np.mean([bool(v.success) for v in videos]):.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
