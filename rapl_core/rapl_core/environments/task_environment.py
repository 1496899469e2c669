"""A task as a gymnasium environment, for those who want the world without ROS."""

from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rapl_core.errors import UnknownNameError
from rapl_core.simulation.simulation import Simulation, Snapshot
from rapl_core.tasks import get_task

Observations = Literal["state", "features", "pixels"]
Observation = NDArray[Any]
"""float64 states, float32 features or uint8 pixels."""


class TaskEnvironment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One world of a task.

    The reward is the human's r* of the state arrived in. Episodes are cut at the task's horizon
    (``truncated``) and never end before. ``info`` holds ``state`` (S,), and at the last step
    ``is_success``: whether the whole episode did what the human prefers.

    :param observations: ``state``: the privileged state (S,); ``features``: what our own policies
        see (F,), near unit size; ``pixels``: the camera's picture (H, W, 3).
    :param render_mode: ``rgb_array`` or None; ``render`` then gives the camera's picture.
    :raises UnknownNameError: if the task or the kind of observation is unknown.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        task_name: str,
        observations: Observations = "state",
        render_mode: str | None = None,
    ) -> None:
        if observations not in get_args(Observations):
            raise UnknownNameError("kind of observation", observations, get_args(Observations))
        if render_mode not in (None, "rgb_array"):
            raise UnknownNameError("render mode", str(render_mode), ["rgb_array"])
        self.task = get_task(task_name)
        self.metadata = {**self.metadata, "render_fps": round(1 / self.task.period_s)}
        self.render_mode = render_mode
        self._kind = observations
        draws = observations == "pixels" or render_mode is not None
        self._simulation = Simulation(self.task, render=draws)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.task.action_names),), np.float32)
        self.observation_space = self._observation_space()

    def _observation_space(self) -> spaces.Space[Observation]:
        if self._kind == "pixels":
            size = self.task.image_size
            return spaces.Box(0, 255, (size, size, 3), np.uint8)
        states = len(self.task.state_names)
        if self._kind == "state":
            return spaces.Box(-np.inf, np.inf, (states,), np.float64)
        width = len(self.task.policy_features(np.zeros(states)))
        return spaces.Box(-np.inf, np.inf, (width,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; its start follows from the seed."""
        super().reset(seed=seed)
        snapshot = self._simulation.reset(0, self.np_random)
        return self._observe(snapshot), {"state": snapshot.state}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        snapshot = self._simulation.step(0, np.asarray(action, dtype=np.float64))
        info: dict[str, Any] = {"state": snapshot.state}
        if snapshot.is_last:
            info["is_success"] = snapshot.success
        cut = snapshot.is_last and not snapshot.terminated
        return (
            self._observe(snapshot), snapshot.human_reward, snapshot.terminated, cut, info,
        )  # fmt: skip

    def render(self) -> NDArray[np.uint8] | None:
        """Return the camera's picture (H, W, 3), or None without a render mode."""
        return None if self.render_mode is None else self._simulation.render(0)

    def close(self) -> None:
        """Free the GL context."""
        self._simulation.close()

    def _observe(self, snapshot: Snapshot) -> Observation:
        if self._kind == "pixels":
            return self._simulation.render(0)
        if self._kind == "features":
            return self.task.policy_features(snapshot.state)
        return snapshot.state.copy()
