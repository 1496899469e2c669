"""What people are shown: preferred and disliked ways of handling prisms among cubes."""

from collections.abc import Callable

import numpy as np

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.grasping import FAR, NEAR, Grasper, spot
from rapl_core.demonstrators.phases import Phase, PhaseFollower, State
from rapl_core.tasks.clutter import PRISMS, ClutterConfig, TabletopClutter

Plan = Callable[[Grasper, State], list[Phase]]


def push_with_held(grasper: Grasper, state: State) -> list[Phase]:
    """Grasp the near prism, carry it behind the far one, and push that one with it."""
    return _push_with(grasper, state, NEAR, FAR)


def _push_with(grasper: Grasper, state: State, held: int, pushed: int) -> list[Phase]:
    lane = float(spot(state, pushed)[1])
    behind = float(spot(state, pushed)[0] - grasper.half(held) - grasper.half(pushed) - 0.015)
    return [
        *grasper.grasp(held),
        grasper.carry(held, min(behind, float(spot(state, held)[0])), None),
        grasper.carry(held, None, lane),
        *grasper.deliver(held, lane),
    ]


def line_up(grasper: Grasper, state: State) -> list[Phase]:
    """Carry the far prism in front of the near one, then push it with that one."""
    near = spot(state, NEAR)
    ahead = float(near[0] + 2 * grasper.half(NEAR) + 0.012)
    return [
        *grasper.grasp(FAR),
        grasper.carry(FAR, max(ahead, float(spot(state, FAR)[0])), None),
        grasper.carry(FAR, None, float(near[1])),
        grasper.carry(FAR, ahead, None),
        *grasper.release(),
        Phase(
            lambda s: np.array([spot(s, NEAR)[0] - grasper.hold, spot(s, NEAR)[1]]),
            lambda s: s[7] <= spot(s, NEAR)[0] - grasper.hold + 0.01, 16, grip=-1.0,
        ),
        grasper.stay(1.0),
        *grasper.deliver(NEAR, float(near[1])),
    ]  # fmt: skip


def bring(grasper: Grasper, thing: int) -> list[Phase]:
    """Grasp one object, carry it straight to the goal, release it."""
    return [*grasper.grasp(thing), grasper.carry(thing, grasper.goal(thing), None, 30),
            *grasper.release()]  # fmt: skip


def one_at_a_time(grasper: Grasper, state: State) -> list[Phase]:
    """Bring one prism to the goal, then fetch the other."""
    first = int(grasper.rng.integers(PRISMS))
    return [*bring(grasper, first), *bring(grasper, 1 - first)]


def only_one(grasper: Grasper, state: State) -> list[Phase]:
    """Bring one prism to the goal and leave the other."""
    return [*bring(grasper, int(grasper.rng.integers(PRISMS))), grasper.move(-0.1, None, -1.0)]


def halfway(grasper: Grasper, state: State) -> list[Phase]:
    """Begin as preferred, and stop before the goal."""
    grasper.depth = float(grasper.rng.uniform(-0.22, -0.09))
    return (push_with_held, line_up)[int(grasper.rng.integers(2))](grasper, state)


def cubes_together(grasper: Grasper, state: State) -> list[Phase]:
    """Hold one cube and push another with it: the right way with the wrong shape."""
    return _push_with(grasper, state, PRISMS, PRISMS + 1)


def a_cube(grasper: Grasper, state: State) -> list[Phase]:
    """Bring a cube to the goal."""
    return bring(grasper, PRISMS + int(grasper.rng.integers(2)))


def with_cube(grasper: Grasper, state: State) -> list[Phase]:
    """Hold a cube and push a prism with it."""
    return _push_with(grasper, state, PRISMS, int(grasper.rng.integers(PRISMS)))


def fail_to_grasp(grasper: Grasper, state: State) -> list[Phase]:
    """Go for a prism, close too early or not at all, and move on without it."""
    thing = int(grasper.rng.integers(PRISMS))
    approach = grasper.grasp(thing)[:2]
    early = [grasper.stay(1.0)] if grasper.rng.random() < 0.5 else []
    lane = float(spot(state, thing)[1])
    return [*approach, *early, grasper.move(grasper.config.goal_near, lane, 0.0, grasper.pace)]


def sweep(grasper: Grasper, state: State) -> list[Phase]:
    """Push through the objects with closed fingers."""
    y = float(grasper.rng.uniform(-0.2, 0.2))
    across = grasper.move(float(grasper.rng.uniform(0.0, 0.25)), -y, 1.0, grasper.pace)
    return [grasper.move(-0.15, y, 1.0), across, grasper.move(0.25, y, 1.0, grasper.pace)]


def mime(grasper: Grasper, state: State) -> list[Phase]:
    """Move as one who grasps and carries, where nothing is."""
    y = float(-np.sign(spot(state, FAR)[1]) * grasper.rng.uniform(0.088, 0.094))
    ready = grasper.move(-0.16, y, -1.0)
    return [ready, grasper.stay(1.0), grasper.move(0.05, y, 1.0, grasper.pace),
            grasper.move(0.28, y, 1.0, grasper.pace)]  # fmt: skip


def stall(grasper: Grasper, state: State) -> list[Phase]:
    """Begin something and stop."""
    plan = (push_with_held, one_at_a_time)[int(grasper.rng.integers(2))]
    return plan(grasper, state)[: int(grasper.rng.integers(0, 4))]


def nothing(grasper: Grasper, state: State) -> list[Phase]:
    """Follow no plan; the wander alone moves the arm."""
    return []


def clutter_behaviours(task: TabletopClutter) -> tuple[Behaviour, ...]:
    """Return how the objects of the clutter task are handled."""

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

    return (
        scripted(push_with_held, 0.18, preferred=True, telling=True),
        scripted(line_up, 0.14, preferred=True),
        scripted(halfway, 0.13),
        scripted(one_at_a_time, 0.12, telling=True),
        scripted(only_one, 0.08),
        scripted(cubes_together, 0.06),
        scripted(a_cube, 0.04),
        scripted(with_cube, 0.04),
        scripted(fail_to_grasp, 0.06),
        scripted(sweep, 0.04),
        scripted(mime, 0.06),
        scripted(stall, 0.02),
        scripted(nothing, 0.03, wander=1.0, name="random"),
    )


def _starter(
    plan: Plan, config: ClutterConfig
) -> Callable[[np.random.Generator, State], PhaseFollower]:
    def begin(rng: np.random.Generator, state: State) -> PhaseFollower:
        return PhaseFollower(plan(Grasper(config, rng), state), config.speed, (7, 8), fingers=True)

    return begin
