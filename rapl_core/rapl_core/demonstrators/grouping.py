"""What people are shown: preferred and disliked ways of handling two cubes."""

from collections.abc import Callable

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.phases import Phase, PhaseFollower, State
from rapl_core.demonstrators.pushing import CUBES, GRIPPER, Pusher
from rapl_core.tasks.tabletop import TabletopConfig, TabletopGroup

BEYOND = 0.05
"""m before the goal's far edge that the gripper must reach to push both cubes out of the goal."""

Plan = Callable[[Pusher, State], list[Phase]]


def together_from_behind(pusher: Pusher, state: State) -> list[Phase]:
    """Slide the near cube behind the far one, then push both as a column."""
    near = pusher.rear(state)
    far = 1 - near
    return [
        *pusher.slide_beside(near, far), *pusher.go_behind(near), *pusher.push_column(near),
    ]  # fmt: skip


def together_from_ahead(pusher: Pusher, state: State) -> list[Phase]:
    """Slide the far cube in front of the near one, then push both as a column."""
    near = pusher.rear(state)
    far = 1 - near
    return [
        *pusher.slide_beside(far, near), *pusher.go_behind(near), *pusher.push_column(near),
    ]  # fmt: skip


def together_side_by_side(pusher: Pusher, state: State) -> list[Phase]:
    """Push the near cube level with the far one, slide it beside it, then push both at once."""
    near = pusher.rear(state)
    far = 1 - near
    level = float(state[CUBES[far]][0] - 0.01)
    return [
        *pusher.go_behind(near), *pusher.push_forward(near, level),
        *pusher.slide_beside(near, far, gap=2 * pusher.config.cube_half), *pusher.push_pair(),
    ]  # fmt: skip


def one_at_a_time(pusher: Pusher, state: State) -> list[Phase]:
    """Bring one cube to the goal, then fetch the other."""
    first = int(pusher.rng.integers(2))
    return [*push_one(pusher, first), *push_one(pusher, 1 - first)]


def only_one(pusher: Pusher, state: State) -> list[Phase]:
    """Bring one cube to the goal and leave the other."""
    return push_one(pusher, int(pusher.rng.integers(2)))


def push_one(pusher: Pusher, cube: int) -> list[Phase]:
    """Stand behind one cube and push it to the goal."""
    return [*pusher.go_behind(cube), *pusher.push_forward(cube)]


def together_halfway(pusher: Pusher, state: State) -> list[Phase]:
    """Begin as preferred, then stop somewhere on the way."""
    ways = (together_from_behind, together_from_ahead, together_side_by_side)
    plan = ways[int(pusher.rng.integers(3))]
    pusher.depth = float(pusher.rng.uniform(-0.22, -0.03))
    return plan(pusher, state)


def bring_together(pusher: Pusher, state: State) -> list[Phase]:
    """Bring the cubes together and leave them where they are."""
    near = pusher.rear(state)
    pair = (near, 1 - near) if pusher.rng.random() < 0.5 else (1 - near, near)
    return [*pusher.slide_beside(*pair), pusher.move_to(-0.15, pusher.free_lane(state))]


def too_far(pusher: Pusher, state: State) -> list[Phase]:
    """Push both together, through the goal and out of it."""
    pusher.depth = float(pusher.rng.uniform(0.2, 0.26))
    return together_from_behind(pusher, state)


def scatter(pusher: Pusher, state: State) -> list[Phase]:
    """Push one cube sideways, away from the other."""
    cube = int(pusher.rng.integers(2))
    own, other = state[CUBES[cube]], state[CUBES[1 - cube]]
    inner = np.sign(other[1] - own[1]) or 1.0
    far = own[1] - inner * pusher.rng.uniform(0.08, 0.2)
    return [
        pusher.move_to(own[0] - pusher.behind - 0.03, own[1] + inner * 0.1),
        pusher.move_to(own[0], own[1] + inner * 0.1),
        pusher.move_to(own[0], far, pace=pusher.pace),
        *([] if pusher.rng.random() < 0.5 else push_one(pusher, 1 - cube)),
    ]


def mime(pusher: Pusher, state: State) -> list[Phase]:
    """Move as one who pushes, where there is no cube."""
    lane = pusher.free_lane(state)
    start = float(pusher.rng.uniform(-0.2, -0.1))
    sideways = lane + float(pusher.rng.uniform(-0.1, 0.1))
    end = pusher.config.goal_near + pusher.depth - pusher.behind
    return [
        pusher.move_to(-0.2, state[GRIPPER][1], 6),
        pusher.move_to(-0.2, sideways),
        pusher.move_to(start, lane),
        pusher.move_to(end, lane, 40, pusher.pace),
    ]


def stall(pusher: Pusher, state: State) -> list[Phase]:
    """Begin something and stop."""
    plan = (together_from_behind, one_at_a_time)[int(pusher.rng.integers(2))]
    return plan(pusher, state)[: int(pusher.rng.integers(0, 3))]


def nothing(pusher: Pusher, state: State) -> list[Phase]:
    """Follow no plan; the wander alone moves the arm."""
    return []


def grouping_behaviours(task: TabletopGroup) -> tuple[Behaviour, ...]:
    """Return how the two cubes of a grouping task are handled."""

    def scripted(
        plan: Plan,
        share: float,
        preferred: bool = False,
        wander: float = 0.0,
        telling: bool = False,
        name: str = "",
    ) -> Behaviour:
        begin = _starter(plan, task.config)
        return Behaviour(name or plan.__name__, begin, share, preferred, wander, telling)

    behaviours = (
        scripted(together_from_behind, 0.12, preferred=True),
        scripted(together_from_ahead, 0.12, preferred=True),
        scripted(together_side_by_side, 0.12, preferred=True, telling=True),
        scripted(together_halfway, 0.10),
        scripted(bring_together, 0.05),
        scripted(too_far, 0.06),
        scripted(one_at_a_time, 0.11, telling=True),
        scripted(only_one, 0.10),
        scripted(scatter, 0.05),
        scripted(mime, 0.10),
        scripted(stall, 0.02),
        scripted(nothing, 0.05, wander=1.0, name="random"),
    )
    reaches_beyond = task.config.gripper_area[1] >= task.config.goal_far - BEYOND
    return tuple(b for b in behaviours if reaches_beyond or b.name != too_far.__name__)


def _starter(
    plan: Plan, config: TabletopConfig
) -> Callable[[np.random.Generator, State], PhaseFollower]:
    def begin(rng: np.random.Generator, state: State) -> PhaseFollower:
        return PhaseFollower(plan(Pusher(config, rng), state), config.speed, (7, 8))

    return begin
