"""For how long objects are hidden from the camera in preferred episodes, of every task.

    python experiments/visibility.py [TASK ...]        # writes experiments/results/visibility.json

By the simulator's segmentation, at every third step: an object is hidden while it shows less than a
quarter of the pixels that it would show if it were alone; outside the picture it shows none. Every
preferred behaviour is played ``--episodes`` times, with the noise of the pool in turn.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from rapl_core.analysis.provenance import commit, versions
from rapl_core.analysis.visibility import HIDDEN, hidden_in_episode
from rapl_core.atomic import write_atomically
from rapl_core.demonstrators import behaviours_of
from rapl_core.demonstrators.collecting import NOISES
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task, task_names

RESULTS = Path(__file__).parent / "results" / "visibility.json"
EVERY = 3
ALLOWED = 1 / 3


def measure(name: str, episodes: int) -> dict[str, object]:
    """Return the figures of one task."""
    task = get_task(name)
    simulation = Simulation(task)
    played: list[tuple[float, str, str, int]] = []
    for behaviour in behaviours_of(task).values():
        for number in range(episodes if behaviour.preferred else 0):
            noise = NOISES[number % len(NOISES)]
            hidden = hidden_in_episode(simulation, behaviour.name, number, noise, EVERY)
            thing = max(hidden, key=lambda name: hidden[name])
            played.append((hidden[thing], thing, behaviour.name, number))
    simulation.close()
    share, thing, way, number = max(played)
    return {
        "episodes": len(played),
        "worst": {
            "share": round(share, 3), "object": thing, "behaviour": way, "episode": number,
        },
        "mean": round(float(np.mean([worst for worst, *_ in played])), 3),
        "episodes_above": sum(worst > ALLOWED for worst, *_ in played),
    }  # fmt: skip


def main() -> None:
    """Measure task after task; of those not asked for the file keeps what it has."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tasks", nargs="*", help="default: all")
    parser.add_argument("--episodes", type=int, default=3, help="of each behaviour (%(default)s)")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    begun_at = commit()  # what runs, whatever is committed meanwhile
    for name in options.tasks or task_names():
        began = time.monotonic()
        row = measure(name, options.episodes) | {
            "hidden_below": HIDDEN,
            "commit": begun_at,
            "mujoco": versions()["mujoco"],
            "wall_s": round(time.monotonic() - began, 1),
        }
        known = json.loads(options.out.read_text()) if options.out.is_file() else {}
        rows = dict(sorted((known | {name: row}).items()))
        write_atomically(options.out, json.dumps(rows, indent=1) + "\n")
        print(name, row, flush=True)


if __name__ == "__main__":
    main()
