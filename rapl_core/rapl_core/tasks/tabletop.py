"""Tabletop grouping: an arm pushes cubes to a goal strip; the human wants them pushed together."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.simulation.arm import ArmKinematics
from rapl_core.tasks.robots import get_robot, robot_spec

Rgba = tuple[float, float, float, float]

SITE = "robot_gripper_grip_site"
BASE_X = -0.5
"""m, robot base; the table's origin is in the middle of its working space."""


@dataclass(frozen=True)
class TabletopConfig:
    """Every number of a grouping scene, in m, s, kg and rad."""

    robot: str = "panda"
    horizon: int = 60
    """Control steps. Long enough that cubes pushed one at a time both reach the goal (tested)."""
    timestep_s: float = 0.004
    substeps: int = 20
    """12.5 Hz control."""
    speed: float = 0.03
    """Largest move of the gripper a control step along an axis."""
    image_size: int = 112
    cube_half: float = 0.03
    cube_mass: float = 0.1
    cube_friction: float = 0.5
    cube_colors: tuple[Rgba, ...] = ((0.85, 0.1, 0.1, 1.0), (0.1, 0.6, 0.15, 1.0))
    """Red and green, as the two prisms of the paper's clutter scene."""
    first_cube: tuple[float, float] = (-0.05, 0.0)
    first_spread: tuple[float, float] = (0.02, 0.05)
    """Half widths of the uniform start around ``first_cube``."""
    second_ahead: float = 0.09
    second_aside: float = 0.11
    """The second cube starts this far ahead of the first and to one side, at random."""
    second_spread: tuple[float, float] = (0.02, 0.02)
    goal_near: float = 0.20
    goal_far: float = 0.36
    goal_half_width: float = 0.30
    gap_threshold: float = 0.10
    """Cubes closer than this, centre to centre, count as together: they touch at 0.06 to 0.085."""
    gripper_start: tuple[float, float] = (-0.17, 0.0)
    gripper_spread: tuple[float, float] = (0.02, 0.08)
    gripper_height: float = 0.03
    gripper_area: tuple[float, float, float, float] = (-0.22, 0.32, -0.25, 0.25)
    """x and y limits of the gripper."""
    finger_opening: float = 0.03
    """m a finger: a fork 6 cm wide, from which a cube does not roll off."""
    camera_position: tuple[float, float, float] = (0.85, 0.0, 0.70)
    camera_target: tuple[float, float, float] = (0.055, 0.0, 0.0)
    camera_fovy_deg: float = 33.0
    visual_triangles: int = 2500
    """For the whole robot; measured in docs as the point where the arm still looks like itself."""


@dataclass(frozen=True)
class TabletopGroup:
    """Push two cubes to the goal strip, together (paper, Section 4.2, Franka Group)."""

    name: str
    title: str
    config: TabletopConfig = field(default_factory=TabletopConfig)
    human_reward_scale: float = 4.35

    camera: str = "front"
    joint_names: tuple[str, ...] = (
        *(f"joint{i}" for i in range(1, 8)), "finger_joint1", "finger_joint2",
    )  # fmt: skip
    state_names: tuple[str, ...] = (
        *(f"joint{i}" for i in range(1, 8)), "gripper_x", "gripper_y", "gripper_z",
        "cube1_x", "cube1_y", "cube1_z", "cube2_x", "cube2_y", "cube2_z",
        "cube1_to_goal", "cube2_to_goal",
    )  # fmt: skip
    state_units: tuple[str, ...] = ("rad",) * 7 + ("m",) * 11
    action_names: tuple[str, ...] = ("gripper_forward", "gripper_left")

    @property
    def horizon(self) -> int:
        """T, transitions an episode."""
        return self.config.horizon

    @property
    def period_s(self) -> float:
        """Control period."""
        return self.config.timestep_s * self.config.substeps

    @property
    def substeps(self) -> int:
        """Physics steps a control period."""
        return self.config.substeps

    @property
    def image_size(self) -> int:
        """Height and width of the camera picture in pixels."""
        return self.config.image_size

    @property
    def visual_triangles(self) -> int:
        """About how many triangles the robot is drawn with."""
        return self.config.visual_triangles

    def build_spec(self) -> mujoco.MjSpec:
        """Return the scene with the robot's full visual meshes."""
        config = self.config
        spec = mujoco.MjSpec()
        spec.modelname = self.name
        spec.option.timestep = config.timestep_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 5
        spec.visual.quality.shadowsize = 0
        spec.visual.headlight.ambient = [0.5] * 3
        spec.visual.headlight.diffuse = [0.5] * 3
        spec.visual.headlight.specular = [0.1] * 3
        spec.worldbody.add_frame(pos=[BASE_X, 0, 0]).attach_body(
            robot_spec(get_robot(config.robot)).body("base"), "robot_", ""
        )
        self._add_table(spec)
        # the gripper's set point, kept in MjData so that a world is MjData and nothing else
        spec.worldbody.add_body(name="set_point", mocap=True)
        for index, color in enumerate(config.cube_colors):
            cube = spec.worldbody.add_body(
                name=f"cube{index + 1}", pos=[0, 0.2 * index, config.cube_half]
            )
            cube.add_freejoint(name=f"cube{index + 1}")
            cube.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[config.cube_half] * 3,
                mass=config.cube_mass,
                rgba=color,
                friction=[config.cube_friction, 0.005, 0.0001],
            )
        return spec

    def _add_table(self, spec: mujoco.MjSpec) -> None:
        config = self.config
        box = mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(
            name="table", type=box, size=[0.7, 0.8, 0.02], pos=[0.0, 0.0, -0.02],
            rgba=[0.76, 0.68, 0.55, 1], friction=[0.6, 0.005, 0.0001],
        )  # fmt: skip
        spec.worldbody.add_geom(
            name="goal", type=box, contype=0, conaffinity=0, rgba=[0.6, 0.82, 1.0, 1],
            size=[(config.goal_far - config.goal_near) / 2, config.goal_half_width, 0.001],
            pos=[(config.goal_far + config.goal_near) / 2, 0, 0],
        )  # fmt: skip
        eye, target = np.array(config.camera_position), np.array(config.camera_target)
        back = (eye - target) / np.linalg.norm(eye - target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        spec.worldbody.add_camera(
            name=self.camera, pos=eye, xyaxes=[*right, *np.cross(back, right)],
            fovy=config.camera_fovy_deg,
        )  # fmt: skip

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
        state = self._checked(state)
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
        state = self._checked(state)
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

    def _checked(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        state = np.asarray(state, dtype=np.float64)
        if state.shape != (len(self.state_names),):
            raise ShapeError(
                f"state of {self.name} has shape {state.shape}, expected ({len(self.state_names)},)"
            )
        return state


class TabletopDynamics:
    """The grouping task on a compiled model."""

    def __init__(self, task: TabletopGroup, model: mujoco.MjModel) -> None:
        robot = get_robot(task.config.robot)
        self._task = task
        self._model = model
        self._home = np.array(robot.home)
        arm = [f"robot_{joint}" for joint in robot.arm_joints]
        self._kinematics = ArmKinematics(model, arm, SITE, self._home)
        self._arm = np.array([model.joint(j).qposadr[0] for j in arm])
        names = [*arm, *(f"robot_gripper_finger_joint{side}" for side in (1, 2))]
        self._joints = np.array([model.joint(j).qposadr[0] for j in names])
        self._joint_dofs = np.array([model.joint(j).dofadr[0] for j in names])
        self._servos = np.array([model.actuator(j).id for j in names])
        self._site = model.site(SITE).id
        self._cubes = [
            int(model.joint(f"cube{i + 1}").qposadr[0]) for i in range(len(task.config.cube_colors))
        ]
        opening = task.config.finger_opening
        self._fingers = np.array([opening, -opening])

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
        target = np.array([*gripper, config.gripper_height])
        angles = self._kinematics.solve(target)
        data.qpos[self._joints] = [*angles, *self._fingers]
        data.ctrl[self._servos] = [*angles, *self._fingers]
        data.mocap_pos[0] = target
        for address, position in zip(self._cubes, cubes, strict=True):
            data.qpos[address : address + 7] = [*position, config.cube_half, 1, 0, 0, 0]
        mujoco.mj_forward(self._model, data)

    def apply(self, data: mujoco.MjData, action: NDArray[np.float64]) -> None:
        """Move the gripper's set point by an action (2,) and the arm's servos after it."""
        config = self._task.config
        low_x, high_x, low_y, high_y = config.gripper_area
        target = data.mocap_pos[0]
        target[0] = np.clip(target[0] + config.speed * action[0], low_x, high_x)
        target[1] = np.clip(target[1] + config.speed * action[1], low_y, high_y)
        angles = data.ctrl[self._servos[:7]]
        for _ in range(2):
            angles = self._kinematics.step(angles, target)
        data.ctrl[self._servos[:7]] = angles

    def state(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the privileged state (18,)."""
        cubes = [data.qpos[a : a + 3] for a in self._cubes]
        distances = [self._task.goal_distance(c) for c in cubes]
        return np.concatenate([data.qpos[self._arm], data.site_xpos[self._site], *cubes, distances])

    def joints(self, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities of the joints in rad and m."""
        return data.qpos[self._joints].copy(), data.qvel[self._joint_dofs].copy()
