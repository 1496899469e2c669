"""Which X-MAGICAL tasks exist: what is asked, and of which body."""

from dataclasses import replace

from rapl_core.tasks.xmagical import AVOID, GROUP, AvoidTask, GroupTask, ProgressTask
from rapl_core.tasks.xmagical_bodies import BODIES
from rapl_core.tasks.xmagical_sweep import SWEEP, SweepTask

XmagicalTask = AvoidTask | GroupTask | SweepTask

SCALES: dict[str, float] = {
    "xmagical_avoid": 1.56,
    "xmagical_avoid_gripper": 1.32,
    "xmagical_avoid_mediumstick": 1.62,
    "xmagical_group": 1.16,
    "xmagical_group_gripper": 1.24,
    "xmagical_group_longstick": 1.28,
    "xmagical_group_mediumstick": 1.12,
    "xmagical_progress": 2.28,
    "xmagical_sweep_gripper": 2.42,
    "xmagical_sweep_gripper_layout": 2.49,
    "xmagical_sweep_longstick": 2.79,
    "xmagical_sweep_longstick_layout": 2.6,
    "xmagical_sweep_mediumstick": 2.38,
    "xmagical_sweep_mediumstick_layout": 2.67,
    "xmagical_sweep_shortstick": 2.45,
    "xmagical_sweep_shortstick_layout": 2.84,
}
"""``human_reward_scale``, as in experiments/oracle/scales.json."""


def xmagical_tasks() -> list[XmagicalTask]:
    """Return every task; without a body in its name it is the short stick's, as in the paper."""
    tasks: list[XmagicalTask] = []
    for body in ("shortstick", "mediumstick", "gripper"):  # the long stick cannot pass the zone
        tasks.append(
            AvoidTask(
                _name("xmagical_avoid", body),
                f"X-MAGICAL: {BODIES[body].title} pushes a block around the blue zone",
                replace(AVOID, body=body),
            )
        )
    for body in BODIES:
        tasks.append(
            GroupTask(
                _name("xmagical_group", body),
                f"X-MAGICAL: {BODIES[body].title} pushes two blocks to the strip, together",
                replace(GROUP, body=body),
            )
        )
        sweeper = f"X-MAGICAL: {BODIES[body].title} sweeps three pieces of debris to the strip"
        config = replace(SWEEP, body=body)
        tasks.append(SweepTask(f"xmagical_sweep_{body}", sweeper, config))
        tasks.append(
            SweepTask(
                f"xmagical_sweep_{body}_layout",
                f"{sweeper}, from random places",
                config,
                layout="random",
            )
        )
    tasks.append(
        ProgressTask(
            "xmagical_progress",
            f"X-MAGICAL: {BODIES['shortstick'].title} pushes two blocks to the strip, in any way",
        )
    )
    return [replace(task, human_reward_scale=SCALES.get(task.name, 1.0)) for task in tasks]


def _name(task: str, body: str) -> str:
    return task if body == "shortstick" else f"{task}_{body}"
