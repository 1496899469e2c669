"""Worlds of one task stepped in one process: one model, N data, one renderer, one thread."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RaplError, ShapeError, UnknownNameError
from rapl_core.simulation.meshes import decimate_visuals
from rapl_core.simulation.rendering import Renderer
from rapl_core.tasks.base import Task

STREAMS = {"demonstrate": 1, "train": 2, "evaluate": 3, "test": 4}
"""Seed stream of each purpose: no two purposes share a start; ``test`` is held-out videos."""

VISUAL_GROUP = 1


def episode_rng(seed: int, stream: str, world: int, episode: int) -> np.random.Generator:
    """Return the generator from which the start of an episode follows, and nothing else.

    :raises UnknownNameError: if ``stream`` is not one of STREAMS.
    """
    if stream not in STREAMS:
        raise UnknownNameError("seed stream", stream, STREAMS)
    return np.random.default_rng([seed, STREAMS[stream], world, episode])


@dataclass(frozen=True)
class Snapshot:
    """One control instant of one world."""

    step: int
    state: NDArray[np.float64]
    """(S,) privileged state."""
    human_reward: float
    """r* of this state."""
    success: bool
    """Whether the whole episode did what the human prefers; False before the last step."""
    is_last: bool
    terminated: bool
    """With is_last: the task ended rather than the time."""
    joint_positions: NDArray[np.float64]
    """rad and m."""
    joint_velocities: NDArray[np.float64]


class Simulation:
    """N worlds of a task.

    :param worlds: how many.
    :param render: whether pictures are wanted; without them no GL is needed.
    :param full_meshes: draw the robot with its original meshes (slow in software GL).
    """

    def __init__(
        self, task: Task, worlds: int = 1, render: bool = True, full_meshes: bool = False
    ) -> None:
        if worlds < 1:
            raise ShapeError(f"a simulation needs at least one world, got {worlds}")
        self.task = task
        spec = task.build_spec()
        if not full_meshes:
            decimate_visuals(spec, VISUAL_GROUP, task.visual_triangles)
        # the buffer is cleared and resolved whole: MuJoCo's own size is 640 x 480
        spec.visual.global_.offwidth = spec.visual.global_.offheight = task.image_size
        self.model = spec.compile()
        self.data = [mujoco.MjData(self.model) for _ in range(worlds)]
        self.dynamics = task.bind(self.model)
        self._states: list[list[NDArray[np.float64]]] = [[] for _ in range(worlds)]
        self._renderer = Renderer(self.model, task.camera, task.image_size) if render else None

    @property
    def worlds(self) -> int:
        """How many worlds there are."""
        return len(self.data)

    def reset(self, world: int, rng: np.random.Generator) -> Snapshot:
        """Begin an episode in a world; its start follows from ``rng`` alone."""
        self.dynamics.reset(self.data[world], rng)
        self._states[world] = []
        return self._observe(world)

    def step(self, world: int, action: NDArray[np.float64]) -> Snapshot:
        """Advance a world by one control period.

        :param action: (A,); values outside [-1, 1] are clipped.
        :raises ShapeError: if the shape is another or a value is not finite.
        :raises RaplError: if the world has not been reset, or its episode is over.
        """
        action = np.asarray(action, dtype=np.float64)
        size = len(self.task.action_names)
        if action.shape != (size,) or not np.isfinite(action).all():
            raise ShapeError(f"action {action} of world {world}: expected ({size},) finite values")
        taken = len(self._states[world]) - 1
        if not 0 <= taken < self.task.horizon:
            raise RaplError(f"world {world} has no episode under way (step {taken}): reset it")
        data = self.data[world]
        self.dynamics.apply(data, np.clip(action, -1.0, 1.0))
        mujoco.mj_step(self.model, data, self.task.substeps)
        mujoco.mj_kinematics(self.model, data)
        return self._observe(world)

    def render(self, world: int) -> NDArray[np.uint8]:
        """Return the picture of a world (H, W, 3)."""
        return self.renderer.render(self.data[world])

    @property
    def draws(self) -> bool:
        """Whether it was made to draw pictures."""
        return self._renderer is not None

    @property
    def renderer(self) -> Renderer:
        """The renderer, for those who draw more than pictures."""
        if self._renderer is None:
            raise RaplError("this simulation was made with render=False")
        return self._renderer

    def close(self) -> None:
        """Free the GL context."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observe(self, world: int) -> Snapshot:
        state = self.dynamics.state(self.data[world])
        states = self._states[world]
        states.append(state)
        is_last = len(states) > self.task.horizon
        positions, velocities = self.dynamics.joints(self.data[world])
        return Snapshot(
            step=len(states) - 1,
            state=state,
            human_reward=self.task.human_reward(state, states[0]),
            success=is_last and self.task.success(np.stack(states)),
            is_last=is_last,
            terminated=False,
            joint_positions=positions,
            joint_velocities=velocities,
        )
