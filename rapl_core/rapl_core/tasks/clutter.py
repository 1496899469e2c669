"""Clutter: of many objects the human wants the two prisms brought to the goal, together."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.tasks.arm_servo import ArmServo
from rapl_core.tasks.arm_task import ArmTask
from rapl_core.tasks.scene import GOAL_BLUE, GREEN, RED, Rgba, SceneConfig, add_box, scene_spec

PRISMS, CUBES = 2, 4
GRIPPER, OPENING = slice(7, 9), 9
POSITIONS = slice(10, 28)
"""(18,) of the state: x, y, z of each object, prisms first."""
DISTANCES = slice(28, 34)


@dataclass(frozen=True)
class ClutterConfig(SceneConfig):
    """Every number of the clutter scene, in m, s, kg and rad."""

    horizon: int = 80
    """Control steps. Long enough that prisms brought one at a time both reach the goal (tested)."""
    prism_half: tuple[float, float, float] = (0.05, 0.025, 0.025)
    """Lying lengthwise and narrower than the open fork, which slides past: so it must be held."""
    prism_mass: float = 0.1
    cube_half: float = 0.025
    cube_mass: float = 0.1
    friction: float = 0.5
    prism_colors: tuple[Rgba, ...] = (GREEN, RED)
    """As in the paper's figure, the green one lies nearer and is held to push the red one."""
    cube_colors: tuple[Rgba, ...] = (GOAL_BLUE, GOAL_BLUE, RED, GREEN)
    """Goal-blue ones lie before the goal: inside it nobody would see them."""
    near_prism: tuple[float, float] = (-0.05, 0.0)
    far_prism: tuple[float, float] = (0.09, 0.12)
    """x, and y to one side, drawn at random; the cubes' places are mirrored with it."""
    cubes: tuple[tuple[float, float], ...] = (
        (0.02, -0.19), (0.14, -0.175), (0.03, 0.25), (0.31, -0.17),
    )  # fmt: skip
    """Beside the ways of the prisms to the goal: whoever steers straight touches none."""
    spread: tuple[float, float] = (0.015, 0.015)
    """Half widths of the uniform start around each place."""
    turn: float = 0.1
    """Largest turn of a prism at the start."""
    goal_far: float = 0.42
    """Deeper than in the grouping scene: two prisms in a row are 20 cm long."""
    finger_opening: float = 0.04
    """m a finger: as far as the gripper opens."""
    finger_speed: float = 0.01
    """Largest move of a finger a control step."""
    gripper_spread: tuple[float, float] = (0.02, 0.05)
    gap_threshold: float = 0.14
    """Prisms closer than this, centre to centre, count as together: in a row they touch at 0.10.
    As in the grouping scene 4 cm are left between them."""
    cube_threshold: float = 0.06
    """A cube further from its start than this was handled, not brushed."""
    camera_target: tuple[float, float, float] = (0.075, 0.0, 0.0)
    camera_fovy_deg: float = 33.0


@dataclass(frozen=True)
class TabletopClutter(ArmTask):
    """Bring two prisms to the goal, together, and leave the cubes (paper, Franka Clutter)."""

    config: ClutterConfig = field(default_factory=ClutterConfig)
    human_reward_scale: float = 3.87

    state_names: tuple[str, ...] = (
        *(f"joint{i}" for i in range(1, 8)), "gripper_x", "gripper_y", "finger_opening",
        *(f"prism{i}_{axis}" for i in range(1, PRISMS + 1) for axis in "xyz"),
        *(f"cube{i}_{axis}" for i in range(1, CUBES + 1) for axis in "xyz"),
        *(f"prism{i}_to_goal" for i in range(1, PRISMS + 1)),
        *(f"cube{i}_to_goal" for i in range(1, CUBES + 1)),
    )  # fmt: skip
    state_units: tuple[str, ...] = ("rad",) * 7 + ("m",) * 27
    action_names: tuple[str, ...] = ("gripper_forward", "gripper_left", "gripper_close")

    def build_spec(self) -> mujoco.MjSpec:
        """Return the scene with the robot's full visual meshes."""
        config = self.config
        spec = scene_spec(self.name, config, self.camera)
        for index, color in enumerate(config.prism_colors):
            start = (0.0, 0.2 * index, config.prism_half[2])
            name = f"prism{index + 1}"
            add_box(spec, name, start, config.prism_half, config.prism_mass, config.friction, color)
        for index, color in enumerate(config.cube_colors):
            start, half = (0.2, 0.2 * index, config.cube_half), (config.cube_half,) * 3
            add_box(spec, f"cube{index + 1}", start, half, config.cube_mass, config.friction, color)
        return spec

    def bind(self, model: mujoco.MjModel) -> "ClutterDynamics":
        """Return the dynamics on a compiled model."""
        return ClutterDynamics(self, model)

    def goal_distances(self, objects: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far along x each object's centre is from where all of it is inside.

        :param objects: (6, 3), prisms first; their turn is not looked at.
        """
        config = self.config
        half = np.array([config.prism_half[0]] * PRISMS + [config.cube_half] * CUBES)
        along = objects[:, 0]
        short = config.goal_near + half - along
        return np.maximum(np.maximum(short, along - (config.goal_far - half)), 0.0)

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* = -max(d1, d2) - ||p1 - p2|| - 0.1 sum_i ||c_i - c_i,start|| in m.

        d of the prisms, p prisms, c cubes (paper, Appendix, Franka Clutter).

        :param start: the first state (34,) of the episode: where the cubes stood.
        """
        objects, distances = self._objects(state), self.checked(state)[DISTANCES]
        moved = np.linalg.norm(objects[PRISMS:] - self._objects(start)[PRISMS:], axis=1)
        gap = np.linalg.norm(objects[0] - objects[1])
        return float(-distances[:PRISMS].max() - gap - 0.1 * moved.sum())

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether both prisms ended in the goal, came there together, and no cube moved.

        Both centres are inside at the last step, their gap is below ``gap_threshold`` at every
        step from the moment either one enters the goal, and no cube ends ``cube_threshold`` from
        where it stood.

        :param states: (T + 1, 34).
        """
        config = self.config
        objects = np.stack([self._objects(state) for state in states])  # (T + 1, 6, 3)
        along = objects[:, :PRISMS, 0]
        inside = (along >= config.goal_near) & (along <= config.goal_far)  # (T + 1, 2)
        if not inside[-1].all():
            return False
        first = int(np.argmax(inside.any(axis=1)))
        gap = np.linalg.norm(objects[first:, 0] - objects[first:, 1], axis=1)
        moved = np.linalg.norm(objects[-1, PRISMS:] - objects[0, PRISMS:], axis=1)
        return bool((gap < config.gap_threshold).all() and (moved < config.cube_threshold).all())

    def policy_features(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return (45,) features near unit size: the state and relative positions made from it."""
        state = self.checked(state)
        objects, gripper = self._objects(state), state[GRIPPER]
        relative = objects[:, :2] - gripper  # (6, 2)
        between = objects[1, :2] - objects[0, :2]
        held = np.abs(relative[:PRISMS]).max(axis=1) < 0.05
        return np.concatenate(
            [
                state[:7], 5 * gripper, [50 * (state[OPENING] - 0.02)],
                5 * objects[:PRISMS].ravel(), 5 * objects[PRISMS:, :2].ravel(),
                5 * state[DISTANCES][:PRISMS], 10 * relative.ravel(), 10 * between,
                [5 * float(np.linalg.norm(objects[0] - objects[1]))], held.astype(np.float64),
                # which way the goal is, so that overshooting can be told
                [5 * (objects[:PRISMS, 0].max() - self.config.goal_far)],
                [5 * (objects[:PRISMS, 0].min() - self.config.goal_near)],
            ]
        ).astype(np.float32)  # fmt: skip

    def _objects(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions (6, 3), prisms first."""
        return self.checked(state)[POSITIONS].reshape(PRISMS + CUBES, 3)


class ClutterDynamics:
    """The clutter task on a compiled model."""

    def __init__(self, task: TabletopClutter, model: mujoco.MjModel) -> None:
        self._task = task
        self._model = model
        self._arm = ArmServo(task.config, model)
        names = [f"prism{i + 1}" for i in range(PRISMS)] + [f"cube{i + 1}" for i in range(CUBES)]
        self._objects = [int(model.joint(name).qposadr[0]) for name in names]

    def reset(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Place gripper, prisms and cubes at a random start."""
        config = self._task.config
        side = rng.choice([-1.0, 1.0])
        places = np.array([config.near_prism, config.far_prism, *config.cubes]) * [1.0, side]
        places = places + rng.uniform(-1, 1, places.shape) * config.spread
        turns = rng.uniform(-config.turn, config.turn, PRISMS)
        start = np.array(config.gripper_start) + rng.uniform(-1, 1, 2) * config.gripper_spread
        self.place(data, start, places, turns)

    def place(
        self,
        data: mujoco.MjData,
        gripper: NDArray[np.float64],
        objects: NDArray[np.float64],
        turns: NDArray[np.float64],
    ) -> None:
        """Put the open gripper (2,) and objects (6, 2), in m, at rest.

        :param turns: (2,) rad, of the prisms.
        """
        config = self._task.config
        mujoco.mj_resetData(self._model, data)
        self._arm.place(data, gripper, config.finger_opening)
        heights = [config.prism_half[2]] * PRISMS + [config.cube_half] * CUBES
        angles = [*turns, *np.zeros(CUBES)]
        for address, spot, height, angle in zip(
            self._objects, objects, heights, angles, strict=True
        ):
            turn = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            data.qpos[address : address + 7] = [*spot, height, *turn]
        mujoco.mj_forward(self._model, data)

    def apply(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Move the gripper by an action (3,): forward, left, and its fingers together if > 0."""
        config = self._task.config
        self._arm.move(data, action[:2])
        told = self._arm.told_opening(data) - config.finger_speed * action[2]
        self._arm.open_fingers(data, float(np.clip(told, 0.0, config.finger_opening)))

    def state(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the privileged state (34,)."""
        objects = np.stack([data.qpos[a : a + 3] for a in self._objects])  # (6, 3)
        return np.concatenate(
            [
                self._arm.angles(data), self._arm.position(data)[:2], [self._arm.opening(data)],
                objects.ravel(), self._task.goal_distances(objects),
            ]
        )  # fmt: skip

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of the joints in rad and m."""
        return self._arm.joints(data)
