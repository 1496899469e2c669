"""Gradient steps per second of SAC: ours, and stable-baselines3's own train() beside it.

python experiments/benchmark_sac.py [--seconds 20] [--out results.json]

The variants take turns, so that a busy machine slows all of them alike; wall time and processor
time are both given.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.logger import Logger

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.policies import EpisodeTransitions, SacConfig, SacTrainer

STEPS = 20


def filled_trainer(config: SacConfig, features: int, actions: int) -> SacTrainer:
    """A trainer with 6,000 random transitions."""
    trainer = SacTrainer(features, actions, config, seed=0)
    rng = np.random.default_rng(0)
    for number in range(60):
        trainer.add_episode(
            EpisodeTransitions(
                episode_id=f"e{number}",
                number=number,
                world=0,
                observations=rng.normal(size=(101, features)).astype(np.float32),
                actions=rng.uniform(-1, 1, (100, actions)).astype(np.float32),
                rewards=rng.normal(-2.0, 1.0, 100),
                terminated=False,
            )
        )
    return trainer


def stable_baselines3(trainer: SacTrainer, fused: bool) -> Callable[[int], object]:
    """stable-baselines3's train() on the same networks and the same replay buffer."""
    model = trainer.model
    model.set_logger(Logger(None, []))
    if not fused:
        for network in (model.actor, model.critic):
            network.optimizer = torch.optim.Adam(
                network.parameters(), lr=trainer.config.learning_rate
            )
    return lambda steps: model.train(steps, trainer.config.batch_size)


def measure(
    variants: dict[str, Callable[[int], object]], seconds: float
) -> dict[str, dict[str, float]]:
    """Milliseconds a gradient step: median wall time and least processor time."""
    wall: dict[str, list[float]] = {name: [] for name in variants}
    processor: dict[str, list[float]] = {name: [] for name in variants}
    for run in variants.values():
        run(STEPS)
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        for name, run in variants.items():
            wall_s, processor_s = time.perf_counter(), time.process_time()
            run(STEPS)
            processor[name].append((time.process_time() - processor_s) / STEPS)
            wall[name].append((time.perf_counter() - wall_s) / STEPS)
    return {
        name: {
            "wall_ms_median": round(1e3 * float(np.median(wall[name])), 2),
            "processor_ms_least": round(1e3 * min(processor[name]), 2),
            "updates_per_s_best": round(1 / min(wall[name]), 1),
        }
        for name in variants
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print a table, write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--features", type=int, default=32, help="size of the observation")
    parser.add_argument("--actions", type=int, default=2, help="size of the action")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=20.0, help="in all")
    parser.add_argument("--out", type=Path, help="write the results here as JSON")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    config = SacConfig()

    def trainer(layer_norm: bool) -> SacTrainer:
        chosen = replace(config, critic_layer_norm=layer_norm)
        return filled_trainer(chosen, options.features, options.actions)

    results = measure(
        {
            "stable-baselines3": stable_baselines3(trainer(False), fused=False),
            "stable-baselines3, fused Adam": stable_baselines3(trainer(False), fused=True),
            "ours": trainer(False).update,
            "ours, critics normalised": trainer(True).update,
        },
        options.seconds,
    )
    base = results["stable-baselines3"]
    hidden = "x".join(str(size) for size in config.hidden)
    print(f"SAC {hidden}, batch {config.batch_size}, {options.threads} thread(s)")
    print(f"{'':<32}{'wall ms':>9}{'cpu ms':>9}{'best /s':>9}{'ratio':>7}")
    for name, row in results.items():
        ratio = base["wall_ms_median"] / row["wall_ms_median"]
        row["ratio"] = round(ratio, 2)
        print(
            f"{name:<32}{row['wall_ms_median']:>9.2f}{row['processor_ms_least']:>9.2f}"
            f"{row['updates_per_s_best']:>9.1f}{ratio:>7.2f}"
        )
    if options.out is not None:
        document = {
            "results": results,
            "seed": 0,
            "commit": commit(),
            "machine": machine(),
            "versions": versions(),
        }
        options.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
