"""Tabletop grouping: an arm pushes cubes to a goal strip; the human wants them pushed together."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.tasks.arm_servo import ArmServo
from rapl_core.tasks.arm_task import ArmTask
from rapl_core.tasks.scene import GREEN, RED, Rgba, SceneConfig, add_box, scene_spec


@dataclass(frozen=True)
class TabletopConfig(SceneConfig):
    """Every number of a grouping scene, in m, s, kg and rad."""

    horizon: int = 60
    """Control steps. Long enough that cubes pushed one at a time both reach the goal (tested)."""
    cube_half: float = 0.03
    cube_mass: float = 0.1
    cube_friction: float = 0.5
    cube_colors: tuple[Rgba, ...] = (RED, GREEN)
    """Red and green, as the two prisms of the paper's clutter scene."""
    first_cube: tuple[float, float] = (-0.05, 0.0)
    first_spread: tuple[float, float] = (0.02, 0.05)
    """Half widths of the uniform start around ``first_cube``."""
    second_ahead: float = 0.09
    second_aside: float = 0.11
    """The second cube starts this far ahead of the first and to one side, at random."""
    second_spread: tuple[float, float] = (0.02, 0.02)
    gap_threshold: float = 0.10
    """Cubes closer than this, centre to centre, count as together: they touch at 0.06 to 0.085."""


KUKA_GROUP = TabletopConfig(
    robot="iiwa",
    # its elbow bends by 120 degrees at most, so its wrist stays 40 cm from its shoulder: only from
    # above does it reach both ends of the table (postures tested)
    base_x=-0.36,
    column_height=0.305,
    gripper_area=(-0.20, 0.28, -0.25, 0.25),
    # into a fork of 6 cm this stiffer arm drives a cube that stands square, and jams it
    finger_opening=0.02,
)


@dataclass(frozen=True)
class TabletopGroup(ArmTask):
    """Push two cubes to the goal strip, together (paper, Section 4.2, Franka Group)."""

    config: TabletopConfig = field(default_factory=TabletopConfig)
    human_reward_scale: float = 4.26

    state_names: tuple[str, ...] = (
        *(f"joint{i}" for i in range(1, 8)), "gripper_x", "gripper_y", "gripper_z",
        "cube1_x", "cube1_y", "cube1_z", "cube2_x", "cube2_y", "cube2_z",
        "cube1_to_goal", "cube2_to_goal",
    )  # fmt: skip
    state_units: tuple[str, ...] = ("rad",) * 7 + ("m",) * 11
    action_names: tuple[str, ...] = ("gripper_forward", "gripper_left")

    def build_spec(self) -> mujoco.MjSpec:
        """Return the scene with the robot's full visual meshes."""
        config = self.config
        spec = scene_spec(self.name, config, self.camera)
        for index, color in enumerate(config.cube_colors):
            add_box(
                spec, f"cube{index + 1}", (0.0, 0.2 * index, config.cube_half),
                (config.cube_half,) * 3, config.cube_mass, config.cube_friction, color,
            )  # fmt: skip
        return spec

    def bind(self, model: mujoco.MjModel) -> "TabletopDynamics":
        """Return the dynamics on a compiled model."""
        return TabletopDynamics(self, model)

    def goal_distance(self, cube: NDArray[np.float64]) -> float:
        """Return how far along x a cube's centre (3,) is from where the whole cube is inside."""
        near = self.config.goal_near + self.config.cube_half
        far = self.config.goal_far - self.config.cube_half
        return float(max(near - cube[0], cube[0] - far, 0.0))

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* = -max(d1, d2) - ||p1 - p2|| in m (paper, Section 4.1, grouping).

        :param start: not needed here.
        """
        state = self.checked(state)
        return float(-max(state[16], state[17]) - np.linalg.norm(state[10:13] - state[13:16]))

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether both cubes ended in the goal and came there together.

        Both centres are inside at the last step, and their gap is below ``gap_threshold`` at
        every step from the moment either one enters the goal.

        :param states: (T + 1, 18).
        """
        states = np.asarray(states)
        along = states[:, [10, 13]]
        inside = (along >= self.config.goal_near) & (along <= self.config.goal_far)  # (T + 1, 2)
        if not inside[-1].all():
            return False
        first = int(np.argmax(inside.any(axis=1)))
        gap = np.linalg.norm(states[first:, 10:13] - states[first:, 13:16], axis=1)
        return bool((gap < self.config.gap_threshold).all())

    def policy_features(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return (27,) features near unit size: the state and relative positions made from it."""
        state = self.checked(state)
        gripper, one, two = state[7:9], state[10:12], state[13:15]
        relative = np.concatenate([one - gripper, two - gripper, two - one])
        gap = float(np.linalg.norm(state[10:13] - state[13:16]))
        return np.concatenate(
            [
                state[:7], 5 * state[7:16], 5 * state[16:18],
                10 * relative, [5 * gap],
                # which way the goal's middle is, so that overshooting can be told
                [5 * (max(one[0], two[0]) - self.config.goal_far)],
                [5 * (min(one[0], two[0]) - self.config.goal_near)],
            ]
        ).astype(np.float32)  # fmt: skip


class TabletopDynamics:
    """The grouping task on a compiled model."""

    def __init__(self, task: TabletopGroup, model: mujoco.MjModel) -> None:
        self._task = task
        self._model = model
        self._arm = ArmServo(task.config, model)
        self._cubes = [
            int(model.joint(f"cube{i + 1}").qposadr[0]) for i in range(len(task.config.cube_colors))
        ]

    def reset(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Place gripper and cubes at a random start."""
        config = self._task.config
        one = np.array(config.first_cube) + rng.uniform(-1, 1, 2) * config.first_spread
        offset = np.array([config.second_ahead, rng.choice([-1.0, 1.0]) * config.second_aside])
        two = one + offset + rng.uniform(-1, 1, 2) * config.second_spread
        start = np.array(config.gripper_start) + rng.uniform(-1, 1, 2) * config.gripper_spread
        self.place(data, start, [one, two])

    def place(
        self,
        data: mujoco.MjData,
        gripper: NDArray[np.float64],
        cubes: list[NDArray[np.float64]],
    ) -> None:
        """Put gripper (2,) and cubes (2,) each, in m, at rest on the table."""
        config = self._task.config
        mujoco.mj_resetData(self._model, data)
        self._arm.place(data, gripper, config.finger_opening)
        for address, position in zip(self._cubes, cubes, strict=True):
            data.qpos[address : address + 7] = [*position, config.cube_half, 1, 0, 0, 0]
        mujoco.mj_forward(self._model, data)

    def apply(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Move the gripper's set point by an action (2,) and the arm's servos after it."""
        self._arm.move(data, action)

    def state(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the privileged state (18,)."""
        cubes = [data.qpos[a : a + 3] for a in self._cubes]
        distances = [self._task.goal_distance(c) for c in cubes]
        return np.concatenate([self._arm.angles(data), self._arm.position(data), *cubes, distances])

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of the joints in rad and m."""
        return self._arm.joints(data)
