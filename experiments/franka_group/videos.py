"""The videos and the rankings of a seed, as every study of franka_group draws them."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from rapl_core.analysis.scenes import TASK
from rapl_core.demonstrators import collect
from rapl_core.preferences import ContestQueries, SimulatedHuman
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import Episode, Ranking


def make_videos(
    seed: int,
    stream: str,
    count: int,
    folder: Path,
    only: Sequence[str] = (),
    first: int = 0,
) -> list[Episode]:
    """Return ``count`` scripted videos; kept in ``folder`` for the other rewards of the seed.

    :param only: behaviours to show; empty for all in their shares.
    :param first: number of the first video.
    """
    kept = folder / f"{stream}-{seed}-{count}{f'-from-{first}' if first else ''}.npz"
    if not kept.is_file():
        simulation = Simulation(get_task(TASK))
        videos = list(collect(simulation, count, seed, stream, only, first))
        simulation.close()
        beside = kept.with_suffix(f".{os.getpid()}.npz")
        np.savez(beside, episodes=np.array([asdict(v) for v in videos], dtype=object))
        beside.replace(kept)
    with np.load(kept, allow_pickle=True) as content:  # our own file of a moment ago
        return [Episode(**fields) for fields in content["episodes"]]


def rank(pool: list[Episode], triplets: int, seed: int, strategy: str) -> list[Ranking]:
    """Ask the simulated human.

    :param strategy: uniform or contest.
    """
    rng = np.random.default_rng([seed, 201])
    human = SimulatedHuman(rng)
    returns = {video.episode_id: video.human_return for video in pool}
    asked: list[tuple[str, ...]] = []
    rankings: list[Ranking] = []
    for number in range(triplets):
        wanted = triplets if strategy == "contest" else 0  # 0: all of them are uniform
        shown = ContestQueries(rng, rankings, wanted).next(list(returns), asked)
        asked.append(shown)
        ranks = human.rank([returns[name] for name in shown])
        rankings.append(Ranking(f"r{number}", "simulated", shown, ranks))
    return rankings
