"""What people are shown of avoiding: ways around the off-limits zone, and through it."""

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.planar_pushing import Mover, Row, nothing, planar_behaviours, stall
from rapl_core.demonstrators.planar_skills import Point, Skill, State, View, Wait
from rapl_core.tasks.xmagical import AvoidTask


def avoiding_behaviours(task: AvoidTask) -> tuple[Behaviour, ...]:
    """Return ways of pushing a block with a zone in between."""
    low_x, high_x, low_y, high_y = task.zone

    def beside(mover: Mover, side: float, margin: float) -> list[Skill]:
        """Push past the zone at ``margin`` m from its edge, and up into the strip."""
        x = (high_x if side > 0 else low_x) + side * margin

        corner = np.array([x, low_y - 0.12])
        start: list[Point] = []

        def beyond(view: View) -> Point:
            """The corner of the way, drawn out so that the direction stays."""
            start[:] = start or [view.blocks[0]]
            way = corner - start[0]
            return np.asarray(corner + 0.4 * way / np.hypot(*way))

        def is_out(view: View) -> bool:
            return bool(side * (view.blocks[0][0] - x) > -0.03)

        return [mover.push(0, beyond, is_out), mover.push_up(0)]

    def nearest(state: State) -> float:
        x = task.blocks_of(state)[0, 0]
        return 1.0 if x - low_x > high_x - x else -1.0

    def around_near(mover: Mover, state: State) -> list[Skill]:
        return beside(mover, nearest(state), float(mover.rng.uniform(0.2, 0.3)))

    def around_far(mover: Mover, state: State) -> list[Skill]:
        return beside(mover, -nearest(state), float(mover.rng.uniform(0.2, 0.3)))

    def around_wide(mover: Mover, state: State) -> list[Skill]:
        return beside(mover, nearest(state), float(mover.rng.uniform(0.38, 0.55)))

    def around_late(mover: Mover, state: State) -> list[Skill]:
        return [Wait(int(mover.rng.integers(5, 55))), *around_near(mover, state)]

    def through(mover: Mover, state: State) -> list[Skill]:
        return [*beneath(mover, state), mover.push_up(0)]

    def beneath(mover: Mover, state: State) -> list[Skill]:
        """Bring the block below the zone where it is not."""
        x = float(mover.rng.uniform(low_x + 0.1, high_x - 0.1))
        if low_x + 0.06 < task.blocks_of(state)[0, 0] < high_x - 0.06:
            return []
        return [mover.push(0, lambda view: np.array([x, low_y - 0.2]), patience=40)]

    def clip_the_corner(mover: Mover, state: State) -> list[Skill]:
        return beside(mover, nearest(state), float(mover.rng.uniform(-0.02, 0.08)))

    def into_the_zone(mover: Mover, state: State) -> list[Skill]:
        end = float(mover.rng.uniform(low_y, high_y))
        return [*beneath(mover, state), mover.push_up(0, end)]

    def linger_in_the_zone(mover: Mover, state: State) -> list[Skill]:
        skills = into_the_zone(mover, state)
        return [*skills, Wait(int(mover.rng.integers(5, 50))), mover.push_up(0)]

    def around_halfway(mover: Mover, state: State) -> list[Skill]:
        margin, end = mover.rng.uniform(0.2, 0.4), float(mover.rng.uniform(0.1, 0.65))
        return [*beside(mover, nearest(state), float(margin))[:1], mover.push_up(0, end)]

    def before_the_zone(mover: Mover, state: State) -> list[Skill]:
        return [*beneath(mover, state), mover.push_up(0, low_y - 0.25)]

    def robot_through(mover: Mover, state: State) -> list[Skill]:
        """Drive through the zone first, then push around it."""
        x = float(mover.rng.uniform(low_x + 0.05, high_x - 0.05))
        side = nearest(state)
        return [
            mover.drive_to(x, high_y + 0.12),
            mover.drive_to(side * 0.75, 0.0),
            *beside(mover, side, float(mover.rng.uniform(0.2, 0.3))),
        ]

    def mime_around(mover: Mover, state: State) -> list[Skill]:
        side = -nearest(state)
        x = side * float(mover.rng.uniform(0.6, 0.8))
        return [mover.drive_to(x, -0.3), mover.drive_to(x, 0.8, 40)]

    rows: tuple[Row, ...] = (
        ("around_near", around_near, 0.12, True),
        ("around_far", around_far, 0.06, True),
        ("around_wide", around_wide, 0.06, True),
        ("around_late", around_late, 0.10, True),
        ("through", through, 0.08, False),
        ("clip_the_corner", clip_the_corner, 0.06, False),
        ("into_the_zone", into_the_zone, 0.08, False),
        ("linger_in_the_zone", linger_in_the_zone, 0.14, False),
        ("around_halfway", around_halfway, 0.10, False),
        ("before_the_zone", before_the_zone, 0.04, False),
        ("robot_through", robot_through, 0.04, False),
        ("mime_around", mime_around, 0.06, False),
        ("stall", stall, 0.02, False),
        ("random", nothing, 0.04, False),
    )
    return planar_behaviours(task, rows, ("around_near", "through"))
