"""What a world is: scene, privileged state, the human's reward, success."""

from rapl_core.tasks.base import Dynamics, Task
from rapl_core.tasks.registry import get_task, task_names

__all__ = ["Dynamics", "Task", "get_task", "task_names"]
