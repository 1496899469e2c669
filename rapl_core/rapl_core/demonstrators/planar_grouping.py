"""What people are shown of two blocks: pushed together, and in other ways."""

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.planar_pushing import Mover, Row, nothing, planar_behaviours, stall
from rapl_core.demonstrators.planar_skills import Back, Skill, State
from rapl_core.tasks.xmagical import GroupTask, PlanarTask, ProgressTask

BOTH = (0, 1)


def planar_grouping_behaviours(task: GroupTask) -> tuple[Behaviour, ...]:
    """Return ways of handling two blocks; in the progress task every way that arrives is liked."""
    any_way = isinstance(task, ProgressTask)
    rows: tuple[Row, ...] = (
        ("together_side_by_side", together_side_by_side, 0.15, True),
        ("together_in_column", together_in_column, 0.12, True),
        ("together_halfway", together_halfway, 0.16, False),
        ("bring_together", bring_together, 0.06, False),
        ("one_at_a_time", one_at_a_time, 0.13, any_way),
        ("only_one", only_one, 0.10, False),
        ("scatter", scatter, 0.09, False),
        ("mime", mime, 0.10, False),
        ("stall", stall, 0.03, False),
        ("random", nothing, 0.06, False),
    )
    return planar_behaviours(task, rows, ("together_side_by_side", "one_at_a_time"))


def nearer(state: State, task: PlanarTask) -> int:
    """Return which block stands nearer to the robot."""
    offset = task.blocks_of(state) - task.robot_of(state)[:2]
    return int(np.hypot(*offset.T).argmin())


def together_side_by_side(mover: Mover, state: State) -> list[Skill]:
    """Push one block beside the other, then both up at once."""
    first = int(mover.rng.integers(2))
    return [mover.bring_beside(first, 1 - first), Back(mover.retreat), mover.push_all_up(BOTH)]


def together_in_column(mover: Mover, state: State) -> list[Skill]:
    """Push the lower block below the other, then up, with the other before it."""
    heights = mover.task.blocks_of(state)[:, 1]
    low = int(heights.argmin())
    skills: list[Skill] = []
    apart = 2 * mover.half + 0.03
    if abs(heights[0] - heights[1]) < apart:  # make room below first
        skills = [mover.push_up(1 - low, float(heights[low] + apart + 0.04)), Back(mover.retreat)]
    return [*skills, mover.bring_below(low, 1 - low), Back(mover.retreat), mover.push_up(low)]


def together_halfway(mover: Mover, state: State) -> list[Skill]:
    """Begin as preferred, then stop somewhere on the way."""
    mover.goal_y = float(mover.rng.uniform(0.1, 0.72))
    plan = (together_side_by_side, together_in_column)[int(mover.rng.integers(2))]
    return plan(mover, state)


def bring_together(mover: Mover, state: State) -> list[Skill]:
    """Bring the blocks together, leave them and drive away."""
    first = int(mover.rng.integers(2))
    away = mover.rng.uniform(-0.7, [0.7, -0.5])
    return [mover.bring_beside(first, 1 - first), Back(mover.retreat), mover.drive_to(*away)]


def one_at_a_time(mover: Mover, state: State) -> list[Skill]:
    """Bring one block to the strip, then fetch the other."""
    first = nearer(state, mover.task)
    return [mover.push_up(first), Back(mover.retreat), mover.push_up(1 - first)]


def only_one(mover: Mover, state: State) -> list[Skill]:
    """Bring one block to the strip and leave the other."""
    return [mover.push_up(int(mover.rng.integers(2))), Back(mover.retreat)]


def scatter(mover: Mover, state: State) -> list[Skill]:
    """Push one block away from the other, and perhaps the other up."""
    block = int(mover.rng.integers(2))
    places = mover.task.blocks_of(state)
    outwards = float(np.sign(places[block][0] - places[1 - block][0])) or 1.0
    aim = places[block] + [outwards * mover.rng.uniform(0.2, 0.6), mover.rng.uniform(-0.3, 0.3)]
    aim = np.clip(aim, -0.9, 0.9)
    rest: list[Skill] = (
        [Back(mover.retreat), mover.push_up(1 - block)] if mover.rng.random() < 0.5 else []
    )
    return [mover.push(block, lambda view: aim, patience=40), *rest]


def mime(mover: Mover, state: State) -> list[Skill]:
    """Drive up as one who pushes, where there is no block."""
    lane = mover.free_lane(mover.task.blocks_of(state))
    return [
        mover.drive_to(lane, float(mover.rng.uniform(-0.6, -0.2))),
        mover.drive_to(lane, float(mover.rng.uniform(0.7, 0.9)), 40),
    ]
