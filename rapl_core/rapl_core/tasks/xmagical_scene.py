"""The X-MAGICAL arena in MuJoCo: planar joints, flat colours, drawn straight from above."""

from dataclasses import dataclass

import mujoco
import numpy as np

from rapl_core.tasks.xmagical_bodies import (
    FINGER_TORQUE,
    GREY,
    HEIGHT,
    LIGHT_GREY,
    OUTLINE,
    RADIUS,
    ROBOT_BIT,
    WHITE,
    Rgba,
    add_shape,
    get_body,
)

CAMERA = "above"
BLOCK_BIT = 2
OCTAGON = float(2 / (1 + np.sqrt(2) + np.sqrt(4 + 2 * np.sqrt(2))))
"""Share of a block's friction that each of four directions 45 degrees apart takes: their sum is
an octagon of friction, within 4 % of a disc. Friction of joints is exact at rest and needs no
contact with a floor."""

PINK: Rgba = (0.9808, 0.7471, 0.8205, 1.0)
RED: Rgba = (0.9624, 0.5042, 0.6481, 1.0)
DARK_RED: Rgba = (0.9520, 0.3679, 0.5513, 1.0)
GREEN: Rgba = (0.7643, 0.8141, 0.5086, 1.0)
DARK_GREEN: Rgba = (0.7182, 0.7778, 0.4127, 1.0)
BLUE: Rgba = (0.5303, 0.7258, 0.8279, 1.0)
"""Colours as the public package draws them; its goal is a lighter red."""
BLOCK_COLORS = {"red": (RED, DARK_RED), "green": (GREEN, DARK_GREEN)}


@dataclass(frozen=True)
class PlanarConfig:
    """Every number of a planar scene, in m, s, kg, N and rad.

    Where no reason stands beside it, it is the public package's (x-magical 0.0.4).
    """

    body: str = "shortstick"
    horizon: int = 0
    """Control steps; 0: the body's own, 100, or 50 for the long stick."""
    timestep_s: float = 1 / 160
    """Half the public package's: MuJoCo's contacts want it."""
    substeps: int = 20
    """8 Hz control."""
    image_size: int = 112
    arena_half: float = 1.1
    view_half: float = 1.1 * 1.02
    speed_limit: float = 0.8
    """m/s; an action of 1 asks for 1 m/s."""
    turn_rate: float = 2.5
    """rad/s at most."""
    full_turn: float = 1.0
    """Action that turns at the full rate, in proportion below it. The public package's is 1/16:
    there all but the smallest action turns at the full rate. Departs from it so that people-like
    noise and a policy's exploration do not throw the robot about; the sweep tasks keep 1/16."""
    drive_force: float = 5.0
    turn_torque: float = 1.0
    block_side: float = float(np.sqrt(np.pi)) * 0.6 * RADIUS
    block_mass: float = 0.01
    block_friction_n: float = 1.5
    """To slide a block over the floor."""
    block_friction_nm: float = 0.1
    """To turn it."""
    block_colors: tuple[str, ...] = ("red",)
    blocks: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """Starts."""
    block_spread: tuple[float, float] = (0.0, 0.0)
    """Half widths of the uniform start around each of them."""
    mirrored: bool = False
    """Blocks stand mirrored, left to right, in half of the starts."""
    robot: tuple[float, float] = (0.0, -0.6)
    robot_spread: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Half widths in x, y and heading."""
    goal_near: float = 0.76
    """The pink strip goes from here to the upper wall."""
    zone: tuple[float, float, float, float] | None = None
    """Off limits: low x, high x, low y, high y."""

    @property
    def block_half(self) -> float:
        """Half a block's side."""
        return self.block_side / 2


def build_planar_spec(name: str, config: PlanarConfig) -> mujoco.MjSpec:
    """Return the scene: arena, goal, off-limits zone, blocks and robot."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.option.timestep = config.timestep_s
    # of a body without children the fast one drops how its x and y servos depend on each other,
    # so that it would drive more slowly along diagonals
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    spec.option.gravity = [0, 0, 0]
    spec.stat.extent = 2.0
    spec.stat.center = [0, 0, 0]
    # colours as they are: no light but an even one
    spec.visual.headlight.ambient = [1, 1, 1]
    spec.visual.headlight.diffuse = [0, 0, 0]
    spec.visual.headlight.specular = [0, 0, 0]
    spec.visual.quality.shadowsize = 0
    spec.visual.quality.numslices = 20
    # finer faces and sides show nothing under an even light and cost two fifths of the drawing;
    # below two stacks cylinders vanish
    spec.visual.quality.numquads = 1
    spec.visual.quality.numstacks = 2
    spec.worldbody.add_camera(
        name=CAMERA, pos=[0, 0, 2], xyaxes=[1, 0, 0, 0, 1, 0],
        proj=mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC, fovy=2 * config.view_half,
    )  # fmt: skip
    _add_arena(spec, config)
    for index, color in enumerate(config.block_colors):
        _add_block(spec, config, f"block{index + 1}", color)
    _add_robot(spec, config)
    return spec


def _add_arena(spec: mujoco.MjSpec, config: PlanarConfig) -> None:
    half, view = config.arena_half, config.view_half
    # drawn in this order, so from the top: what lies below is found hidden before it is shaded
    if config.zone is not None:
        _paint(spec, "zone", config.zone, -0.30, BLUE)
    # the strip lies over the border, as in the public package
    strip = (-2 * view, 2 * view, config.goal_near, config.goal_near + 0.4)
    _paint(spec, "goal", _grown(strip, -OUTLINE / 2), -0.32, PINK)
    _paint(spec, "goal_edge", _grown(strip, OUTLINE / 2), -0.34, RED)
    _paint(spec, "floor", _grown((-half, half, -half, half), -OUTLINE / 2), -0.36, WHITE)
    _paint(spec, "border", _grown((-half, half, -half, half), OUTLINE / 2), -0.38, GREY)
    _paint(spec, "surroundings", (-2 * view, 2 * view, -2 * view, 2 * view), -0.40, LIGHT_GREY)
    for side, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        spec.worldbody.add_geom(
            name=f"wall{side + 1}", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[half, 1, 1],
            pos=[-half * x, -half * y, 0], zaxis=[x, y, 0], rgba=[0, 0, 0, 0],
            friction=[0.4, 0, 0], contype=0, conaffinity=ROBOT_BIT | BLOCK_BIT,
        )  # fmt: skip


def _grown(area: tuple[float, float, float, float], by: float) -> tuple[float, float, float, float]:
    return area[0] - by, area[1] + by, area[2] - by, area[3] + by


def _paint(
    spec: mujoco.MjSpec,
    name: str,
    area: tuple[float, float, float, float],
    height: float,
    rgba: Rgba,
) -> None:
    low_x, high_x, low_y, high_y = area
    spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_BOX, rgba=rgba, contype=0, conaffinity=0,
        size=[(high_x - low_x) / 2, (high_y - low_y) / 2, 0.001],
        pos=[(low_x + high_x) / 2, (low_y + high_y) / 2, height],
    )  # fmt: skip


def _add_planar_joints(body: mujoco.MjsBody, name: str) -> None:
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    body.add_joint(name=f"{name}_x", type=slide, axis=[1, 0, 0])
    body.add_joint(name=f"{name}_y", type=slide, axis=[0, 1, 0])
    body.add_joint(name=f"{name}_yaw", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])


def _add_block(spec: mujoco.MjSpec, config: PlanarConfig, name: str, color: str) -> None:
    box, half = mujoco.mjtGeom.mjGEOM_BOX, config.block_half
    fill, edge = BLOCK_COLORS[color]
    block = spec.worldbody.add_body(name=name)
    _add_planar_joints(block, name)
    share = OCTAGON * config.block_friction_n
    for axis in ("x", "y"):
        spec.joint(f"{name}_{axis}").frictionloss = share
    spec.joint(f"{name}_yaw").frictionloss = config.block_friction_nm
    for slope in (1, -1):
        diagonal = spec.add_tendon(name=f"{name}_diagonal{slope:+d}", frictionloss=share)
        diagonal.wrap_joint(f"{name}_x", np.sqrt(0.5))
        diagonal.wrap_joint(f"{name}_y", slope * np.sqrt(0.5))
    block.add_geom(
        name=name, type=box, size=[half, half, HEIGHT], rgba=edge, mass=config.block_mass,
        friction=[0.25, 0, 0], contype=BLOCK_BIT, conaffinity=ROBOT_BIT | BLOCK_BIT,
    )  # fmt: skip
    block.add_geom(
        name=f"{name}_top", type=box, rgba=fill, mass=0.0, contype=0, conaffinity=0,
        size=[half - OUTLINE, half - OUTLINE, 0.001], pos=[0, 0, HEIGHT + 0.01],
    )  # fmt: skip


def _add_robot(spec: mujoco.MjSpec, config: PlanarConfig) -> None:
    body_of = get_body(config.body)
    robot = spec.worldbody.add_body(name="robot")
    _add_planar_joints(robot, "robot")
    add_shape(robot, body_of)
    robot.add_site(name="drive", size=[0.001] * 3, rgba=[0, 0, 0, 0])
    # velocity servos of limited force along the body's own axes: it drives and turns, and resists
    # being pushed aside. With a gain of inertia / timestep a servo settles within two steps;
    # with a greater one it jumps between the limits of its force.
    gain = 1.0 / config.timestep_s
    _add_servo(spec, "forward", [0, 1, 0, 0, 0, 0], gain * body_of.mass, config.drive_force)
    _add_servo(spec, "sideways", [1, 0, 0, 0, 0, 0], gain * body_of.mass, config.drive_force)
    _add_servo(spec, "turn", [0, 0, 0, 0, 0, 1], gain * body_of.inertia, config.turn_torque)
    if body_of.has_fingers:
        for finger in ("left_finger", "right_finger"):
            servo = spec.add_actuator(name=finger, target=finger)
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = 80.0, -80.0, -2.0
            servo.forcelimited = True
            servo.forcerange = [-FINGER_TORQUE, FINGER_TORQUE]


def _add_servo(
    spec: mujoco.MjSpec, name: str, gear: list[float], gain: float, limit: float
) -> None:
    """Add force = gain (ctrl - velocity), at most ``limit``, on the robot's own axes."""
    servo = spec.add_actuator(name=name, target="drive", gear=gear)
    servo.trntype = mujoco.mjtTrn.mjTRN_SITE
    servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0], servo.biasprm[2] = gain, -gain
    servo.forcelimited = True
    servo.forcerange = [-limit, limit]
