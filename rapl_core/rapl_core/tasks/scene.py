"""What the tabletop scenes share: robot, table, goal strip, camera."""

from dataclasses import dataclass

import mujoco
import numpy as np

from rapl_core.tasks.robots import UNDRAWN_GROUP, get_robot, robot_spec

Rgba = tuple[float, float, float, float]

RED: Rgba = (0.85, 0.1, 0.1, 1.0)
GREEN: Rgba = (0.1, 0.6, 0.15, 1.0)
GOAL_BLUE: Rgba = (0.6, 0.82, 1.0, 1.0)


@dataclass(frozen=True)
class SceneConfig:
    """The numbers of a table with a robot, in m, s, kg and rad."""

    robot: str = "panda"
    base_x: float = -0.5
    """Robot base; the table's origin is in the middle of its working space."""
    column_height: float = 0.0
    """The robot stands on a column of this height."""
    horizon: int = 60
    """Control steps."""
    timestep_s: float = 0.004
    substeps: int = 20
    """12.5 Hz control."""
    speed: float = 0.03
    """Largest move of the gripper a control step along an axis."""
    image_size: int = 112
    table_half: tuple[float, float] = (0.7, 0.8)
    goal_near: float = 0.20
    goal_far: float = 0.36
    goal_half_width: float = 0.30
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


def scene_spec(name: str, config: SceneConfig, camera: str) -> mujoco.MjSpec:
    """Return robot, table, goal and camera, without objects."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.option.timestep = config.timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 5
    spec.visual.quality.shadowsize = 0
    spec.visual.headlight.ambient = [0.5] * 3
    spec.visual.headlight.diffuse = [0.5] * 3
    spec.visual.headlight.specular = [0.1] * 3
    spec.worldbody.add_frame(pos=[config.base_x, 0, config.column_height]).attach_body(
        robot_spec(get_robot(config.robot)).body("base"), "robot_", ""
    )
    _add_table(spec, config)
    _add_camera(spec, config, camera)
    # the gripper's set point, kept in MjData so that a world is MjData and nothing else
    spec.worldbody.add_body(name="set_point", mocap=True)
    return spec


def _add_table(spec: mujoco.MjSpec, config: SceneConfig) -> None:
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(
        name="table", type=box, size=[*config.table_half, 0.02], pos=[0.0, 0.0, -0.02],
        rgba=[0.76, 0.68, 0.55, 1], friction=[0.6, 0.005, 0.0001],
    )  # fmt: skip
    _add_edge(spec, config.table_half)
    spec.worldbody.add_geom(
        name="goal", type=box, contype=0, conaffinity=0, rgba=GOAL_BLUE,
        size=[(config.goal_far - config.goal_near) / 2, config.goal_half_width, 0.001],
        pos=[(config.goal_far + config.goal_near) / 2, 0, 0],
    )  # fmt: skip
    if config.column_height > 0:
        spec.worldbody.add_geom(
            name="column", type=mujoco.mjtGeom.mjGEOM_CYLINDER, contype=0, conaffinity=0,
            size=[0.08, config.column_height / 2, 0], rgba=[0.35, 0.35, 0.37, 1],
            pos=[config.base_x, 0, config.column_height / 2],
        )  # fmt: skip


def _add_edge(spec: mujoco.MjSpec, half: tuple[float, float]) -> None:
    """Keep objects on the table by walls that are not drawn, outside the picture.

    A cube squeezed out from under a finger can slide to the edge. It would fall for ever, and one
    such episode, with a reward a hundred times the others', is enough to spoil the critics.
    """
    edge = spec.worldbody.add_body(name="edge")
    for name, x, y in (("front", 1, 0), ("back", -1, 0), ("left", 0, 1), ("right", 0, -1)):
        edge.add_geom(
            name=f"edge_{name}", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1],
            pos=[x * half[0], y * half[1], 0], zaxis=[-x, -y, 0],
            group=UNDRAWN_GROUP,
        )  # fmt: skip


def _add_camera(spec: mujoco.MjSpec, config: SceneConfig, camera: str) -> None:
    eye, target = np.array(config.camera_position), np.array(config.camera_target)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    spec.worldbody.add_camera(
        name=camera, pos=eye, xyaxes=[*right, *np.cross(back, right)],
        fovy=config.camera_fovy_deg,
    )  # fmt: skip


def add_box(
    spec: mujoco.MjSpec,
    name: str,
    start: tuple[float, float, float],
    half: tuple[float, float, float],
    mass: float,
    friction: float,
    color: Rgba,
) -> None:
    """Add a free box; ``name`` is that of its body and of its joint.

    :param half: half lengths along x, y, z.
    """
    body = spec.worldbody.add_body(name=name, pos=start)
    body.add_freejoint(name=name)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        mass=mass,
        rgba=color,
        friction=[friction, 0.005, 0.0001],
    )
