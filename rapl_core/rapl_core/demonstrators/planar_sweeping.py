"""What people are shown of sweeping: all the debris, some of it, or none."""

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.planar_grouping import mime
from rapl_core.demonstrators.planar_pushing import Mover, Row, nothing, planar_behaviours, stall
from rapl_core.demonstrators.planar_skills import Back, Skill, State
from rapl_core.tasks.xmagical_sweep import SweepTask


def sweeping_behaviours(task: SweepTask) -> tuple[Behaviour, ...]:
    """Return ways of sweeping; a long stick takes what it spans at once."""
    at_once = task.body.width > 1.0
    rows: tuple[Row, ...] = (
        ("sweep_all", sweep_row if at_once else sweep_each, 0.30, True),
        ("sweep_from_outside", sweep_row if at_once else sweep_outside_first, 0.12, True),
        ("sweep_two", sweep_two, 0.14, False),
        ("sweep_one", sweep_one, 0.12, False),
        ("sweep_halfway", sweep_halfway, 0.14, False),
        ("mime", mime, 0.07, False),
        ("stall", stall, 0.04, False),
        ("random", nothing, 0.07, False),
    )
    return planar_behaviours(task, rows, ("sweep_all", "sweep_one"))


def sweep_each(mover: Mover, state: State) -> list[Skill]:
    """Push one piece after the other, each time the neighbour."""
    order = list(np.argsort(mover.task.blocks_of(state)[:, 0]))
    return push_in_order(mover, order if mover.rng.random() < 0.5 else order[::-1])


def sweep_outside_first(mover: Mover, state: State) -> list[Skill]:
    """Push the outer pieces first."""
    left, middle, right = np.argsort(mover.task.blocks_of(state)[:, 0])
    return push_in_order(mover, [left, right, middle])


def sweep_row(mover: Mover, state: State) -> list[Skill]:
    """Push all pieces at once."""
    return [mover.push_all_up(tuple(range(mover.task.blocks)))]


def sweep_two(mover: Mover, state: State) -> list[Skill]:
    """Push two of the pieces."""
    return push_in_order(mover, list(mover.rng.permutation(mover.task.blocks)[:2]))


def sweep_one(mover: Mover, state: State) -> list[Skill]:
    """Push one of the pieces."""
    return push_in_order(mover, [int(mover.rng.integers(mover.task.blocks))])


def sweep_halfway(mover: Mover, state: State) -> list[Skill]:
    """Push all pieces and stop somewhere on the way."""
    row = mover.task.blocks_of(state)[:, 1].max()
    mover.goal_y = float(mover.rng.uniform(row + 0.1, 0.75))
    if mover.task.body.width > 1.0:
        return sweep_row(mover, state)
    return sweep_each(mover, state)


def push_in_order(mover: Mover, order: list[int]) -> list[Skill]:
    """Push pieces up one after the other, without dawdling: three take all the time there is."""
    mover.pace = mover.task.config.speed_limit
    return [skill for piece in order for skill in (mover.push_up(int(piece)), Back(mover.retreat))]
