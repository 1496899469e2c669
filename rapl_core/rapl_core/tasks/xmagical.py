"""The paper's X-MAGICAL tasks: a planar robot pushes blocks to the pink strip as people want."""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import ShapeError
from rapl_core.tasks.xmagical_bodies import PlanarBody, get_body
from rapl_core.tasks.xmagical_dynamics import PlanarDynamics, PlanarScene
from rapl_core.tasks.xmagical_scene import CAMERA, PlanarConfig, build_planar_spec

AVOID = PlanarConfig(
    # below the zone's middle, where straight up leads through it; the outermost starts need
    # hardly any detour, so that exploring finds the way around
    blocks=((0.0, -0.4),), block_spread=(0.3, 0.05), robot=(0.0, -0.8),
    robot_spread=(0.3, 0.05, 0.3), zone=(-0.18, 0.18, 0.1, 0.6),
)  # fmt: skip
GROUP = PlanarConfig(
    # one ahead of the other and aside, as in franka_group: pushing the near one up brings them
    # together, and ends below the middle of both. With both side by side and 0.46 m apart, SAC
    # with r* itself had learnt nothing after 30,000 steps
    blocks=((-0.105, -0.35), (0.105, 0.05)), block_spread=(0.02, 0.04), mirrored=True,
    robot=(0.0, -0.8), robot_spread=(0.3, 0.05, 0.3), block_colors=("red", "green"),
)  # fmt: skip


@dataclass(frozen=True)
class PlanarTask:
    """What the tasks in the X-MAGICAL arena have in common.

    The state begins with the robot's x, y and heading and the blocks' x and y; with a gripper it
    ends with how far that is open.
    """

    name: str
    title: str
    config: PlanarConfig = field(default_factory=PlanarConfig)
    human_reward_scale: float = 1.0

    camera: str = CAMERA
    visual_triangles: int = 0
    """There are no meshes."""

    @property
    def body(self) -> PlanarBody:
        """The robot's body."""
        return get_body(self.config.body)

    @property
    def horizon(self) -> int:
        """T, transitions an episode."""
        return self.config.horizon or self.body.horizon

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
    def blocks(self) -> int:
        """How many blocks there are."""
        return len(self.config.block_colors)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the robot's joints as in ``joint_states``."""
        fingers = ("left_finger", "right_finger") if self.body.has_fingers else ()
        return ("x", "y", "yaw", *fingers)

    @property
    def action_names(self) -> tuple[str, ...]:
        """(2,), with a gripper (3,)."""
        return ("drive", "turn_left", "close")[: 2 + self.body.has_fingers]

    @property
    def state_names(self) -> tuple[str, ...]:
        """(S,) names of the privileged state."""
        places = (f"block{i + 1}_{axis}" for i in range(self.blocks) for axis in ("x", "y"))
        fingers = ("opening",) if self.body.has_fingers else ()
        return ("robot_x", "robot_y", "robot_yaw", *places, *self.derived_names, *fingers)

    @property
    def state_units(self) -> tuple[str, ...]:
        """(S,) units of the privileged state."""
        units = {"robot_yaw": "rad", "opening": "1"}
        return tuple(units.get(name, "m") for name in self.state_names)

    @property
    def derived_names(self) -> tuple[str, ...]:
        """What stands in the state beside positions."""
        return tuple(f"block{i + 1}_to_goal" for i in range(self.blocks))

    def derived(self, blocks: NDArray[np.float64]) -> list[float]:
        """Return the values of ``derived_names`` for blocks (N, 2)."""
        return [self.goal_distance(block) for block in blocks]

    def build_spec(self) -> mujoco.MjSpec:
        """Return the scene."""
        return build_planar_spec(self.name, self.config)

    def bind(self, model: mujoco.MjModel) -> PlanarDynamics:
        """Return the dynamics on a compiled model."""
        return PlanarDynamics(self.config, model, self.draw_start, self.observe)

    def draw_start(self, rng: np.random.Generator) -> PlanarScene:
        """Return a random start."""
        config = self.config
        blocks = np.array(config.blocks)
        if config.mirrored:
            blocks = blocks * [rng.choice([-1.0, 1.0]), 1.0]
        blocks = blocks + rng.uniform(-1, 1, blocks.shape) * config.block_spread
        robot = np.array([*config.robot, 0.0]) + rng.uniform(-1, 1, 3) * config.robot_spread
        return PlanarScene(robot, blocks)

    def observe(self, scene: PlanarScene) -> NDArray[np.float64]:
        """Return the state (S,) of a scene."""
        opening = [] if scene.opening is None else [scene.opening]
        return np.array(
            [*scene.robot, *scene.blocks.ravel(), *self.derived(scene.blocks), *opening]
        )

    def goal_distance(self, block: NDArray[np.float64]) -> float:
        """Return how far a block's centre (2,) is from where the whole block is in the strip."""
        return float(max(self.config.goal_near + self.config.block_half - block[1], 0.0))

    def robot_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x, y and heading (..., 3) of the robot in states (..., S)."""
        return states[..., :3]

    def blocks_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x and y (..., N, 2) of the blocks in states (..., S)."""
        return states[..., 3 : 3 + 2 * self.blocks].reshape(*states.shape[:-1], self.blocks, 2)

    def rest_of(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what stands behind the positions (..., R) in states (..., S)."""
        return states[..., 3 + 2 * self.blocks :]

    def policy_features(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return features (F,) near unit size: the state, and blocks as the robot sees them.

        Each block is given where it stands, and ahead of and beside the robot; so is what the
        blocks are apart.
        """
        state = self.checked(state)
        robot, blocks = self.robot_of(state), self.blocks_of(state)
        ahead = np.array([-np.sin(robot[2]), np.cos(robot[2])])
        frame = np.stack([ahead, [ahead[1], -ahead[0]]])  # (2, 2) rows: ahead, right
        seen = (blocks - robot[:2]) @ frame.T  # (N, 2)
        apart = np.diff(blocks, axis=0)  # (N - 1, 2)
        return np.concatenate(
            [
                robot[:2], ahead, blocks.ravel(), 2 * seen.ravel(),
                3 * apart.ravel(), 3 * (apart @ frame.T).ravel(),
                2 * self.rest_of(state),
            ]
        ).astype(np.float32)  # fmt: skip

    def checked(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a state (S,) as an array.

        :raises ShapeError: if it has another shape.
        """
        state = np.asarray(state, dtype=np.float64)
        if state.shape != (len(self.state_names),):
            raise ShapeError(
                f"state of {self.name} has shape {state.shape}, expected ({len(self.state_names)},)"
            )
        return state

    def in_goal(self, states: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether each block's centre is in the strip (..., N) in states (..., S)."""
        return self.blocks_of(states)[..., 1] >= self.config.goal_near


@dataclass(frozen=True)
class AvoidTask(PlanarTask):
    """Push a block to the strip around the off-limits zone (paper, Section 4.1, avoiding)."""

    config: PlanarConfig = AVOID
    safety_distance: float = 0.15
    """m from a block's centre to the zone: half a block's diagonal, so that at no angle it
    reaches in."""

    @property
    def zone(self) -> tuple[float, float, float, float]:
        """Low x, high x, low y, high y of the off-limits zone."""
        if self.config.zone is None:
            raise ShapeError(f"{self.name} has no off-limits zone; set PlanarConfig.zone")
        return self.config.zone

    @property
    def derived_names(self) -> tuple[str, ...]:
        """What stands in the state beside positions."""
        return "block1_to_goal", "block1_to_zone"

    def derived(self, blocks: NDArray[np.float64]) -> list[float]:
        """Return the values of ``derived_names`` for blocks (1, 2)."""
        return [self.goal_distance(blocks[0]), float(self.zone_distance(blocks[0]))]

    def zone_distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far points (..., 2) are from the zone, 0 inside it (...)."""
        low_x, high_x, low_y, high_y = self.zone
        aside = np.maximum.reduce([low_x - points[..., 0], points[..., 0] - high_x])
        along = np.maximum.reduce([low_y - points[..., 1], points[..., 1] - high_y])
        return np.asarray(np.hypot(np.maximum(aside, 0), np.maximum(along, 0)))

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* = -d_goal - 2 [d_obs < d_safety], d in m (paper, Section 4.1, avoiding).

        :param start: not needed here.
        """
        to_goal, to_zone = self.checked(state)[5:7]
        return float(-to_goal - 2.0 * (to_zone < self.safety_distance))

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether the block ended in the strip and nothing went through the zone.

        The block's centre never came nearer to the zone than half its side, and until the block
        was in the strip the robot's centre was outside the zone.

        :param states: (T + 1, S).
        """
        states = np.asarray(states)
        inside = self.in_goal(states)[:, 0]
        if not inside[-1] or (states[:, 6] < self.config.block_half).any():
            return False
        outside = np.flatnonzero(~inside)
        arrival = outside[-1] + 1 if len(outside) else 0
        pushing = self.robot_of(states)[:arrival, :2]
        return bool((self.zone_distance(pushing) > 0).all())

    def policy_features(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the features of every planar task, and the robot's distance from the zone."""
        robot = self.robot_of(self.checked(state))[:2]
        near = 2 * self.zone_distance(robot)
        return np.append(super().policy_features(state), near).astype(np.float32)


@dataclass(frozen=True)
class GroupTask(PlanarTask):
    """Push two blocks to the strip, together (paper, Section 4.1, grouping)."""

    config: PlanarConfig = GROUP
    gap_threshold: float = 0.36
    """m; blocks nearer than this, centre to centre, count as together: they touch at 0.21 to
    0.30. As in franka_group 1.7 sides."""

    def gap(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ||p1 - p2|| (...) in states (..., S)."""
        blocks = self.blocks_of(states)
        return np.asarray(np.linalg.norm(blocks[..., 0, :] - blocks[..., 1, :], axis=-1))

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* = -max(d1, d2) - ||p1 - p2|| in m (paper, Section 4.1, grouping).

        :param start: not needed here.
        """
        state = self.checked(state)
        return float(-max(state[7:9]) - self.gap(state))

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether both blocks ended in the strip and came there together.

        Both centres are inside at the last step, and their gap is below ``gap_threshold`` at
        every step from the moment either one enters the strip.

        :param states: (T + 1, S).
        """
        states = np.asarray(states)
        inside = self.in_goal(states)  # (T + 1, 2)
        if not inside[-1].all():
            return False
        first = int(np.argmax(inside.any(axis=1)))
        return bool((self.gap(states[first:]) < self.gap_threshold).all())


@dataclass(frozen=True)
class ProgressTask(GroupTask):
    """Push two blocks to the strip, in whatever way (paper, Appendix, Q1)."""

    def human_reward(self, state: NDArray[np.float64], start: NDArray[np.float64]) -> float:
        """Return r* = -(d1 + d2) / 2 in m: progress alone, as XIRL rewards it.

        :param start: not needed here.
        """
        return -float(self.checked(state)[7:9].mean())

    def success(self, states: NDArray[np.float64]) -> bool:
        """Return whether both blocks' centres ended in the strip."""
        return bool(self.in_goal(np.asarray(states)[-1]).all())
