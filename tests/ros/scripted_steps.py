"""Scripted episodes stepped in-process, for what the graph does to be held against."""

import numpy as np
from numpy.typing import NDArray

from rapl_core.demonstrators import behaviours_of, make_demonstrator
from rapl_core.demonstrators.demonstrator import Demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task
from rapl_core.tasks.base import Task

Instant = tuple[NDArray[np.float64], float | None, bool | None, NDArray[np.uint8]]
"""State, r*, success and picture."""


def demonstrators(task: Task, worlds: int) -> list[Demonstrator]:
    """One a world, each in a way that people prefer, with their noise: they push, so blocks touch
    and slide."""
    preferred = [b.name for b in behaviours_of(task).values() if b.preferred]
    return [
        make_demonstrator(task, preferred[w % len(preferred)], np.random.default_rng([3, w]), 0.1)
        for w in range(worlds)
    ]


def scripted_steps(name: str, worlds: int, seed: int, episode: int) -> list[list[Instant]]:
    """All instants of one episode of each world."""
    task = get_task(name)
    simulation = Simulation(task, worlds=worlds)
    found: list[list[Instant]] = []
    for world, demonstrator in enumerate(demonstrators(task, worlds)):
        snapshot = simulation.reset(world, episode_rng(seed, "train", world, episode))
        instants: list[Instant] = []
        while True:
            pixels = simulation.render(world).copy()
            instants.append((snapshot.state, snapshot.human_reward, snapshot.success, pixels))
            if snapshot.is_last:
                break
            action = demonstrator.act(snapshot.state, snapshot.step)
            snapshot = simulation.step(world, action)
        found.append(instants)
    simulation.close()
    return found
