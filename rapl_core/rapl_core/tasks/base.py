"""What a task is: a scene, privileged state, the human's reward and success."""

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray


class Dynamics(Protocol):
    """A task bound to a compiled model: how a world starts and how an action moves it.

    It holds no state of a world: everything that evolves is in the ``MjData`` given.
    """

    def reset(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Place robot and objects at a random start."""

    def apply(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Set controls from an action (A,), each in [-1, 1], before a control period."""

    def state(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the privileged state (S,)."""

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of ``joint_names`` in rad and m."""


class Task(Protocol):
    """A task: names, sizes, and functions of the logged state alone."""

    @property
    def name(self) -> str:
        """Registered name, e.g. ``franka_group``."""

    @property
    def title(self) -> str:
        """One line for people."""

    @property
    def horizon(self) -> int:
        """T, transitions an episode."""

    @property
    def period_s(self) -> float:
        """Control period."""

    @property
    def image_size(self) -> int:
        """Height and width of the camera picture in pixels."""

    @property
    def camera(self) -> str:
        """Name of the camera in the model."""

    @property
    def visual_triangles(self) -> int:
        """About how many triangles the robot is drawn with."""

    @property
    def substeps(self) -> int:
        """Physics steps a control period."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """(S,) names of the privileged state."""

    @property
    def state_units(self) -> tuple[str, ...]:
        """(S,) units of the privileged state."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """(A,) names of the actions, each in [-1, 1]."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the robot's joints as in ``joint_states``."""

    def build_spec(self) -> mujoco.MjSpec:
        """Return the scene with the robot's full visual meshes."""

    def bind(self, model: mujoco.MjModel) -> Dynamics:
        """Return the dynamics on a compiled model."""

    @property
    def human_reward_scale(self) -> float:
        """Factor on r* where it is the robot's reward: what ``policies.fit_scale`` gives for 60
        demonstrations of seed 0, as in experiments/oracle/scales.json."""

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* of one state (S,).

        :param start: the first state (S,) of its episode: where objects stood.
        """

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether an episode of states (T + 1, S) did what the human prefers."""

    def policy_features(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return what the policy sees (F,), computed from the state (S,) alone."""
