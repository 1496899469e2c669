"""Names of the tasks in gymnasium's registry, made from our own."""

import gymnasium

from rapl_core.tasks import get_task, task_names


def environment_id(task_name: str) -> str:
    """Return the name of a task in gymnasium, e.g. ``rapl/FrankaGroup-v0`` of franka_group."""
    return "rapl/" + "".join(word.capitalize() for word in task_name.split("_")) + "-v0"


def register_environments() -> None:
    """Register every task that gymnasium does not know yet."""
    for name in task_names():
        if environment_id(name) not in gymnasium.registry:
            gymnasium.register(
                id=environment_id(name),
                entry_point="rapl_core.environments.task_environment:TaskEnvironment",
                # a whole episode is judged: the environment itself ends it
                max_episode_steps=None,
                kwargs={"task_name": get_task(name).name},
            )
