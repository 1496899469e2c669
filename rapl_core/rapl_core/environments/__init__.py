"""Every task as a gymnasium environment: ``import rapl_core.environments`` registers them.

``gymnasium.make("rapl/FrankaGroup-v0", observations="state")``; see :class:`TaskEnvironment`.
"""

from rapl_core.environments.registration import environment_id, register_environments
from rapl_core.environments.task_environment import TaskEnvironment

register_environments()

__all__ = ["TaskEnvironment", "environment_id", "register_environments"]
