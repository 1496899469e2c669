"""What a reward wishes for: its value along scenes placed by hand, beside the human's own.

    python experiments/franka_group/landscape.py --seed 0

Look here before spending hours on learning. Each line is normalised: 0 where nothing has been
done, 1 where both cubes are in the goal together. Writes ``landscape.png`` and ``landscape.json``.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import torch
from learn import HERE, TASK, make_encoder, make_videos, rank
from numpy.typing import NDArray

from rapl_core.representations import make_extractor
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

Point = tuple[float, float]
Scene = tuple[Point, Point, Point]
"""Gripper, red cube, green cube."""

PATH = np.linspace(-0.05, 0.28, 9)
LANES = (-0.08, 0.0, 0.08)


def scenes(lane: float) -> dict[str, list[Scene]]:
    """Return ways through the task, each as scenes in order."""
    y = lane
    return {
        "both together, side by side": [
            ((x - 0.07, y), (x, y), (x + 0.02, y + 0.07)) for x in PATH
        ],
        "both together, in a column": [
            ((x - 0.07, y), (x, y), (min(x + 0.065, 0.345), y)) for x in PATH
        ],
        "red alone": [((x - 0.07, y), (x, y), (0.04, y + 0.11)) for x in PATH],
        "green alone": [((x - 0.07, y + 0.11), (-0.05, y), (x, y + 0.11)) for x in PATH],
        "green fetched, red in the goal": [
            ((x - 0.07, y + 0.11), (0.28, y), (x, y + 0.11)) for x in PATH
        ],
        "gap growing in the goal": [
            ((0.18, y), (0.26, y - gap / 2), (0.26, y + gap / 2))
            for gap in np.linspace(0.065, 0.35, len(PATH))
        ],
        "arm alone": [((x - 0.07, y - 0.1), (-0.05, y), (0.04, y + 0.11)) for x in PATH],
    }


def draw(lanes: tuple[float, ...]) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.float64]]]:
    """Return pictures (lanes, N, H, W, 3) and r* (lanes, N) of every way."""
    simulation = Simulation(get_task(TASK))
    ways: dict[str, tuple[list[NDArray[np.uint8]], list[float]]] = {}
    for lane in lanes:
        for name, way in scenes(lane).items():
            frames, human = ways.setdefault(name, ([], []))
            for gripper, red, green in way:
                simulation.dynamics.place(
                    simulation.data[0], np.array(gripper), [np.array(red), np.array(green)]
                )
                frames.append(simulation.render(0))
                state = simulation.dynamics.state(simulation.data[0])
                human.append(simulation.task.human_reward(state, state))
    simulation.close()
    shape = (len(lanes), len(PATH))
    return {
        name: (np.stack(frames).reshape(*shape, *frames[0].shape), np.array(human).reshape(shape))
        for name, (frames, human) in ways.items()
    }


def normalised(values: dict[str, NDArray[np.float64]]) -> dict[str, list[float]]:
    """Return each way's mean over lanes, 0 at rest and 1 at both cubes in the goal."""
    means = {name: value.mean(axis=0) for name, value in values.items()}
    low = means["arm alone"][0]
    high = means["both together, side by side"][-1]
    return {name: ((value - low) / (high - low)).tolist() for name, value in means.items()}


def picture(rewards: dict[str, dict[str, list[float]]], path: Path) -> None:
    """Draw every way once, with a line for each reward."""
    names = list(next(iter(rewards.values())))
    figure, axes = plt.subplots(2, 4, figsize=(13, 5.6), sharey=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for reward, ways in rewards.items():
            truth = reward == "human's reward r*"
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
    """Draw the landscape of all rewards from the same pool and rankings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--triplets", type=int, default=150)
    parser.add_argument("--pool", type=int, default=300)
    parser.add_argument("--work", type=Path, default=Path("runs/study"))
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    make_extractor(DEFAULT_BACKBONE, RAW_RECIPE)  # before a GL context exists, see learn.py
    pool = make_videos(options.seed, "demonstrate", options.pool, options.work)
    by_id = {video.episode_id: video for video in pool}
    rankings = rank(pool, options.triplets, options.seed, "contest")
    drawn = draw(LANES)
    rewards = {"human's reward r*": normalised({name: human for name, (_, human) in drawn.items()})}
    for label, reward, preset in (
        ("RAPL tuned", "rapl", "tuned"),
        ("RAPL paper", "rapl", "paper"),
        ("RLHF tuned", "rlhf", "tuned"),
        ("raw ImageNet", "imagenet", ""),
    ):
        encoder, _ = make_encoder(
            reward, preset or "paper", pool, rankings, options.seed, options.work
        )
        experts = [encoder.embed_expert(i, by_id[i].frames) for i in encoder.expert_ids]

        def value(frames: NDArray[np.uint8], rate: Callable = encoder.reward) -> NDArray:
            # a way through the task, slowed down to a video's length as transport wants
            z = np.repeat(encoder.embed(frames), 7, axis=0)  # noqa: B023
            return rate(z, experts).values.reshape(len(frames), 7).mean(axis=1)  # noqa: B023

        rewards[label] = normalised(
            {
                name: np.stack([value(lane) for lane in frames])
                for name, (frames, _) in drawn.items()
            }
        )
        print(label, {n: [round(w[k], 2) for k in (0, 4, 8)] for n, w in rewards[label].items()})
    options.results.mkdir(parents=True, exist_ok=True)
    (options.results / "landscape.json").write_text(json.dumps(rewards, indent=1) + "\n")
    picture(rewards, options.results / "landscape.png")


if __name__ == "__main__":
    main()
