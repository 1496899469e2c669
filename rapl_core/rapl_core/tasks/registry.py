"""The tasks that exist, by name."""

from functools import cache

from rapl_core.errors import UnknownNameError
from rapl_core.tasks.base import Task
from rapl_core.tasks.clutter import TabletopClutter
from rapl_core.tasks.tabletop import KUKA_GROUP, TabletopGroup
from rapl_core.tasks.xmagical_catalogue import xmagical_tasks


@cache
def _tasks() -> dict[str, Task]:
    tasks: list[Task] = [
        TabletopGroup("franka_group", "Franka Panda pushes two cubes to the goal, together"),
        TabletopGroup(
            "kuka_group",
            "Kuka iiwa pushes two cubes to the goal, together",
            config=KUKA_GROUP,
            human_reward_scale=4.64,
        ),
        *xmagical_tasks(),
        TabletopClutter(
            "franka_clutter", "Franka Panda brings two prisms among cubes to the goal, together"
        ),
    ]
    return {task.name: task for task in tasks}


def task_names() -> list[str]:
    """Return the names of all tasks."""
    return sorted(_tasks())


def get_task(name: str) -> Task:
    """Return a task by name.

    :raises UnknownNameError: if there is none of that name.
    """
    if name not in _tasks():
        raise UnknownNameError("task", name, _tasks())
    return _tasks()[name]
