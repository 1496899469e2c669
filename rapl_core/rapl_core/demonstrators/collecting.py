"""Collect videos of scripted behaviours in-process, without ROS."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rapl_core.demonstrators.demonstrator import draw_behaviours, make_demonstrator
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.types import Episode

NOISES = (0.0, 0.1, 0.3)
"""Standard deviations of action noise, drawn evenly: people are not machines."""


def behaviour_rng(seed: int, world: int, episode: int) -> np.random.Generator:
    """Return the generator of what a demonstrator does in an episode."""
    return np.random.default_rng([seed, 101, world, episode])


def collect(
    simulation: Simulation,
    episodes: int,
    seed: int,
    stream: str = "demonstrate",
    only: Sequence[str] = (),
    first: int = 0,
) -> Iterator[Episode]:
    """Yield ``episodes`` episodes of world 0.

    Where the simulation draws nothing, pictures have no pixels: (T + 1, 0, 0, 3).

    :param stream: seed stream of the starts, see ``STREAMS``.
    :param only: behaviours to show; empty for all in their shares.
    :param first: number of the first episode; later calls go on from there.
    """
    task = simulation.task
    shown = draw_behaviours(task, episodes, behaviour_rng(seed, 0, first), tuple(only))
    for number, behaviour in enumerate(shown, start=first):
        rng = behaviour_rng(seed, 1, number)
        noise = float(rng.choice(NOISES))
        demonstrator = make_demonstrator(task, behaviour, rng, noise)
        snapshot = simulation.reset(0, episode_rng(seed, stream, 0, number))
        snapshots, frames, actions = [snapshot], [_picture(simulation)], []
        while not snapshot.is_last:
            actions.append(demonstrator.act(snapshot.state, snapshot.step))
            snapshot = simulation.step(0, actions[-1])
            snapshots.append(snapshot)
            frames.append(_picture(simulation))
        period_ns = round(task.period_s * 1e9)
        first_ns = number * (task.horizon + 1) * period_ns
        yield Episode(
            episode_id=f"{stream}-{seed}-{number:05d}",
            task=task.name,
            world=0,
            purpose="demonstrate",
            controller="demonstrator",
            frames=np.stack(frames),
            states=np.stack([s.state for s in snapshots]),
            actions=np.stack(actions),
            stamps_ns=first_ns + period_ns * np.arange(len(frames), dtype=np.int64),
            human_rewards=np.array([s.human_reward for s in snapshots]),
            success=snapshot.success,
            behaviour=behaviour,
        )


def _picture(simulation: Simulation) -> NDArray[np.uint8]:
    return simulation.render(0) if simulation.draws else np.zeros((0, 0, 3), dtype=np.uint8)
