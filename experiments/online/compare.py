"""Success of a run that was aligned once beside one that was aligned again while the robot learnt.

    ./run_all.sh franka_group --seed 2 --online 0
    ./run_all.sh franka_group --seed 2
    python experiments/online/compare.py runs/franka_group/rapl-tuned-online0-seed2 \\
        runs/franka_group/rapl-tuned-seed2

Writes ``<task>-online<N>-seed<seed>.png`` and ``.json`` into ``results`` beside itself. Where a
run with ``--reward ground_truth`` lies beside the first one, its curve is drawn as the oracle. Both
have as many rankings in all, unless people were slower than the robot; the picture says how many.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

from rapl_core.analysis.curves import curve_of, oracle_curve  # noqa: E402
from rapl_core.analysis.figures import NamedCurve, draw_success  # noqa: E402
from rapl_core.analysis.stages import plain  # noqa: E402
from rapl_core.errors import CorruptFileError, RaplError  # noqa: E402
from rapl_core.policies.learning_curve import LearningCurve  # noqa: E402

HERE = Path(__file__).parent
SAME = ("task", "reward", "preset", "seed", "steps", "worlds", "pool_episodes", "triplets")
"""Settings that two runs must share to be compared."""


def load(folder: Path) -> dict[str, Any]:
    """Return what the results of a finished run say.

    :raises CorruptFileError: if it has none.
    """
    path = folder / "results.json"
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CorruptFileError(f"{folder} holds no finished run: {error}") from error


def check(offline: dict[str, Any], online: dict[str, Any]) -> None:
    """
    :raises RaplError: if the runs differ in more than the alignments while learning.
    """
    ours, theirs = offline["settings"], online["settings"]
    differing = [f"{n}: {ours[n]!r}, {theirs[n]!r}" for n in SAME if ours[n] != theirs[n]]
    if differing:
        raise RaplError(f"the runs differ in {'; '.join(differing)}")
    if offline.get("online") or not online.get("online"):
        raise RaplError(
            "expected a run with --online 0 first and one that was aligned again second"
        )


def named(label: str, curve: LearningCurve, dashed: bool = False) -> NamedCurve:
    """A curve to draw."""
    steps = np.array([point.steps for point in curve.points], dtype=np.float64)
    rates = np.array([point.success_rate for point in curve.points])
    return NamedCurve(label, steps, rates, dashed)


def curve(folder: Path) -> LearningCurve:
    """
    :raises CorruptFileError: if the run has no curve.
    """
    found = curve_of(folder)
    if found is None:
        raise CorruptFileError(f"{folder} has no success curve")
    return found


def row(found: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a run."""
    success = found["success"]
    return {
        "rankings": max([found["triplets"], *(e["rankings"] for e in found["online"] or [])]),
        "final": success["final"],
        "mean_of_last_three": success["mean_of_last_three"],
        "by_step": [[p["steps"], p["success_rate"]] for p in success["by_step"]],
        "online": found["online"],
        "agreement": found["agreement"],
        "wall_time_s": found["wall_time_s"],
        "commit": found["commit"],
    }


def main() -> None:
    """Compare two runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("offline", type=Path, help="folder of the run that was aligned once")
    parser.add_argument("online", type=Path, help="folder of the run with --online")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    arguments = parser.parse_args()
    offline, online = load(arguments.offline), load(arguments.online)
    check(offline, online)
    settings = offline["settings"]
    found = {name: row(run) for name, run in (("offline", offline), ("online", online))}
    labels = {"offline": "aligned once", "online": "aligned again while learning"}
    curves = [
        named(f"{labels[name]}, {found[name]['rankings']} rankings", curve(folder))
        for name, folder in (("offline", arguments.offline), ("online", arguments.online))
    ]
    oracle = oracle_curve(arguments.offline)
    if oracle is not None:
        curves.append(named("oracle (r* as reward)", oracle, dashed=True))
    marks = [(entry["steps"], "aligned") for entry in online["online"] if entry["version"]]
    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    draw_success(axes, curves, marks)
    title = f"{settings['task']}, {settings['reward']} {settings['preset']}, seed"
    axes.set_title(f"{title} {settings['seed']}", fontsize=10)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rounds = len(online["online"])
    stem = arguments.out / f"{settings['task']}-online{rounds}-seed{settings['seed']}"
    figure.savefig(stem.with_suffix(".png"), dpi=130)
    plt.close(figure)
    kept = {"settings": {name: settings[name] for name in SAME}, **found}
    stem.with_suffix(".json").write_text(json.dumps(plain(kept), indent=1) + "\n")
    for name, entry in found.items():
        last = entry["mean_of_last_three"]
        words = "-" if last is None else f"{last:.0%}"
        print(f"{name}: {entry['rankings']} rankings, last three evaluations {words}")
    print(f"{stem.with_suffix('.png')}")


if __name__ == "__main__":
    try:
        main()
    except RaplError as error:
        sys.exit(f"compare.py: {error}")
