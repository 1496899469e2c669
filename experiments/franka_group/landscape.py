"""What a reward wishes for: its value along scenes placed by hand, beside the human's own.

    python experiments/franka_group/landscape.py --seed 12

Draws what ``learn.py`` found of that seed's rewards before their learning, and of the last
alignment's. Each line is normalised: 0 where nothing has been done, 1 where both cubes are in the
goal together. Writes ``landscape.png``.
"""

import argparse
import json
from pathlib import Path

import matplotlib
import numpy as np

from rapl_core.analysis.scenes import PATH, TRUTH, Scenes

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

HERE = Path(__file__).parent
LABELS = {
    "rapl-tuned-online9": "RAPL tuned",
    "rapl-paper": "RAPL paper",
    "rlhf-tuned-online9": "RLHF tuned",
    "imagenet": "raw ImageNet",
}
"""By the file's name without the seed."""

Ways = dict[str, list[float]]


def found(results: Path, seed: int) -> dict[str, Ways]:
    """The rewards of a seed by label."""
    rewards: dict[str, Ways] = {}
    for stem, label in LABELS.items():
        path = results / f"{stem}-{seed}.json"
        if not path.is_file():
            continue
        run = json.loads(path.read_text())
        last = run.get("scenes_last")
        rewards[f"{label}, before learning" if last else label] = run["scenes"]["ways"]
        if last:
            rewards[f"{label}, after the last alignment"] = last["ways"]
    return rewards


def picture(rewards: dict[str, Ways], path: Path) -> None:
    """Draw every way once, with a line for each reward."""
    names = list(next(iter(rewards.values())))
    figure, axes = plt.subplots(2, 4, figsize=(13, 5.6), sharey=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for reward, ways in rewards.items():
            truth = reward == TRUTH
            axis.plot(
                np.linspace(0, 1, len(PATH)),
                np.clip(ways[name], -1.6, 2.0),
                label=reward,
                color="black" if truth else None,
                linewidth=2.4 if truth else 1.4,
                linestyle="--" if truth else "-",
            )
        axis.set_title(name, fontsize=10)
        axis.axhline(0, color="0.8", linewidth=0.6)
        axis.axhline(1, color="0.8", linewidth=0.6)
        axis.set_ylim(-1.7, 2.1)
    axes[0, 0].set_ylabel("reward: 0 at rest, 1 done")
    axes[1, 0].set_ylabel("reward: 0 at rest, 1 done")
    for axis in axes[1]:
        axis.set_xlabel("way gone")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    axes.flat[-1].axis("off")
    axes.flat[-1].legend(handles, labels, loc="center", frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def main() -> None:
    """Draw the landscape of all rewards of a seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--work", type=Path, default=Path("runs/study"))
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    rewards = {
        TRUTH: Scenes.drawn(options.work).truth().scaled(),
        **found(options.results, options.seed),
    }
    for label, along in rewards.items():
        print(
            label,
            {name: [round(values[k], 2) for k in (0, 4, 8)] for name, values in along.items()},
        )
    picture(rewards, options.results / "landscape.png")


if __name__ == "__main__":
    main()
