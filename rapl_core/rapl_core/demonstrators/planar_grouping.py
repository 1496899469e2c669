"""What people are shown of two blocks: pushed together, and in other ways."""

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.planar_pushing import Mover, Row, nothing, planar_behaviours, stall
from rapl_core.demonstrators.planar_skills import Back, Skill, State
from rapl_core.tasks.xmagical import GroupTask, PlanarTask, ProgressTask

BOTH = (0, 1)
LONG = 1.0
"""m; what is wider has no room to push one block past the other."""


def planar_grouping_behaviours(task: GroupTask) -> tuple[Behaviour, ...]:
    """Return ways of handling two blocks; in the progress task every way that arrives is liked."""
    any_way = isinstance(task, ProgressTask)
    rows: list[Row] = [
        ("together_straight", together_straight, 0.12, True),
        ("together_halfway", together_halfway, 0.16, False),
        ("bring_together", bring_together, 0.06, False),
        ("scatter", scatter, 0.09, False),
        ("mime", mime, 0.10, False),
        ("stall", stall, 0.03, False),
        ("random", nothing, 0.06, False),
    ]
    if task.body.width > LONG:
        return planar_behaviours(task, rows, ("together_straight", "together_halfway"))
    rows += [
        ("together_side_by_side", together_side_by_side, 0.08, True),
        ("together_in_column", together_in_column, 0.07, True),
        ("one_at_a_time", one_at_a_time, 0.13, any_way),
        ("only_one", only_one, 0.10, False),
    ]
    return planar_behaviours(task, rows, ("together_straight", "one_at_a_time"))


def lower(state: State, task: PlanarTask) -> int:
    """Return which block stands lower in the picture."""
    return int(task.blocks_of(state)[:, 1].argmin())


def together_straight(mover: Mover, state: State) -> list[Skill]:
    """Push the lower block up beside the other, then both up at once."""
    low = lower(state, mover.task)
    if mover.is_wide:  # what pushes the one meets the other
        return [mover.push_up(low), mover.push_all_up(BOTH)]
    level = float(mover.task.blocks_of(state)[1 - low, 1])
    return [mover.push_up(low, level), Back(mover.retreat), mover.push_all_up(BOTH)]


def together_side_by_side(mover: Mover, state: State) -> list[Skill]:
    """Push one block beside the other, then both up at once."""
    low = lower(state, mover.task)
    return [mover.bring_beside(low, 1 - low), Back(mover.retreat), mover.push_all_up(BOTH)]


def together_in_column(mover: Mover, state: State) -> list[Skill]:
    """Push the lower block below the other, then up, with the other before it."""
    heights = mover.task.blocks_of(state)[:, 1]
    low = lower(state, mover.task)
    skills: list[Skill] = []
    apart = 2 * mover.half + 0.03
    if abs(heights[0] - heights[1]) < apart:  # make room below first
        skills = [mover.push_up(1 - low, float(heights[low] + apart + 0.04)), Back(mover.retreat)]
    return [*skills, mover.bring_below(low, 1 - low), Back(mover.retreat), mover.push_up(low)]


def together_halfway(mover: Mover, state: State) -> list[Skill]:
    """Begin as preferred, then stop somewhere on the way."""
    mover.goal_y = float(mover.rng.uniform(0.1, 0.62))
    plan = (together_side_by_side, together_in_column)[int(mover.rng.integers(2))]
    return plan(mover, state)


def bring_together(mover: Mover, state: State) -> list[Skill]:
    """Bring the blocks together, leave them and drive away."""
    first = int(mover.rng.integers(2))
    away = mover.rng.uniform(-0.7, [0.7, -0.5])
    return [mover.bring_beside(first, 1 - first), Back(mover.retreat), mover.drive_to(*away)]


def one_at_a_time(mover: Mover, state: State) -> list[Skill]:
    """Bring one block to the strip, then fetch the other."""
    low = lower(state, mover.task)
    first = 1 - low if mover.is_wide else low  # a wide body would take the upper one along
    return [alone(mover, state, first), Back(mover.retreat), mover.push_up(1 - first)]


def only_one(mover: Mover, state: State) -> list[Skill]:
    """Bring one block to the strip and leave the other."""
    return [alone(mover, state, int(mover.rng.integers(2))), Back(mover.retreat)]


def alone(mover: Mover, state: State, block: int) -> Skill:
    """Bring one block to the strip past the other: a wide body pushes with its outer end."""
    free = mover.task.body.width / 2 - 0.06 if mover.is_wide else 0.0
    return mover.push_up(block, aside=-outwards(mover, state, block) * free)


def outwards(mover: Mover, state: State, block: int) -> float:
    """Return 1 where a block stands to the right of the other, else -1."""
    across = mover.task.blocks_of(state)[:, 0]
    return 1.0 if across[block] >= across[1 - block] else -1.0


def scatter(mover: Mover, state: State) -> list[Skill]:
    """Push one block away from the other, and perhaps the other up."""
    block = int(mover.rng.integers(2))
    rest: list[Skill] = (
        [Back(mover.retreat), mover.push_up(1 - block)] if mover.rng.random() < 0.5 else []
    )
    far, up = mover.rng.uniform(0.3, 0.6), mover.rng.uniform(-0.3, 0.2)
    place = mover.task.blocks_of(state)[block]
    aim = np.clip(place + [outwards(mover, state, block) * far, up], -0.9, 0.9)
    return [mover.push(block, lambda view: aim, patience=40), *rest]


def mime(mover: Mover, state: State) -> list[Skill]:
    """Drive up as one who pushes, where there is no block."""
    lane = mover.free_lane(mover.task.blocks_of(state))
    return [
        mover.drive_to(lane, float(mover.rng.uniform(-0.6, -0.2))),
        mover.drive_to(lane, float(mover.rng.uniform(0.7, 0.9)), 40),
    ]
