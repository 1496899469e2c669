"""The four bodies of X-MAGICAL (Zakka et al. 2021): three sticks and a gripper."""

from dataclasses import dataclass

import mujoco
import numpy as np

from rapl_core.errors import UnknownNameError

Rgba = tuple[float, float, float, float]

RADIUS = 0.2
"""m, r of the public package, of which all sizes are multiples."""
GREY: Rgba = (0.6353, 0.6392, 0.6863, 1.0)
DARK_GREY: Rgba = (0.5643, 0.5689, 0.6252, 1.0)
LIGHT_GREY: Rgba = (0.9051, 0.9061, 0.9183, 1.0)
WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
BLACK: Rgba = (0.1, 0.1, 0.1, 1.0)
"""Colours as the public package draws them."""

HEIGHT = 0.1
"""m, half height of what collides; from above it is not seen."""
OUTLINE = 0.012
"""m, the line of two pixels in 384 that the public package draws."""
ROBOT_BIT = 1
"""Parts of the robot do not collide with each other."""
BODY_FRICTION = 0.25
"""Against a block: the public package multiplies 0.5 by 0.5, MuJoCo takes the greater."""
FINGER_FRICTION = 2.5
"""The same, 5 by 0.5."""
ROBOT_MASS = 1.0
FINGER_MASS = 0.125
"""kg."""
FINGER_RANGE = np.pi / 8
"""rad, open; 0 is closed."""
FINGER_TORQUE = 4.0
"""N m."""


@dataclass(frozen=True)
class PlanarBody:
    """A body that drives along its own y axis and turns."""

    name: str
    title: str
    width: float
    """m across; of the gripper the diameter of its round part."""
    depth: float
    """m along the direction of driving."""
    eyes: tuple[float, float]
    """m, the eyes stand at (+-x, y)."""
    horizon: int = 100
    has_fingers: bool = False

    @property
    def mass(self) -> float:
        """kg."""
        return ROBOT_MASS + 2 * FINGER_MASS * self.has_fingers

    @property
    def inertia(self) -> float:
        """kg m^2 about the centre, fingers left out."""
        if self.has_fingers:
            return ROBOT_MASS * RADIUS**2 / 2
        return ROBOT_MASS * (self.width**2 + self.depth**2) / 12

    @property
    def front(self) -> float:
        """m from the centre to what pushes a block in front of it."""
        return self.depth / 2


def _stick(name: str, radii: float, horizon: int = 100) -> PlanarBody:
    size = (radii * RADIUS, 0.5 * RADIUS)
    return PlanarBody(name, f"a stick {size[0]:.1f} m wide", *size, (0.06, 0.0), horizon)


BODIES = {
    body.name: body
    for body in (
        _stick("shortstick", 1.5),
        _stick("mediumstick", 3.0),
        # the public package gives it half the time
        _stick("longstick", 8.0, horizon=50),
        PlanarBody("gripper", "a gripper", 2 * RADIUS, 2 * RADIUS, (0.08, 0.06), has_fingers=True),
    )
}


def get_body(name: str) -> PlanarBody:
    """Return a body by name.

    :raises UnknownNameError: if there is none of that name.
    """
    if name not in BODIES:
        raise UnknownNameError("X-MAGICAL body", name, BODIES)
    return BODIES[name]


def add_shape(body: mujoco.MjsBody, body_of: PlanarBody) -> None:
    """Add what is drawn and collides to the robot's body in a scene; its mass is 1 kg."""
    half = (body_of.width / 2, body_of.depth / 2)
    if body_of.has_fingers:
        cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
        _collider(body, cylinder, [half[0], HEIGHT, 0], DARK_GREY, ROBOT_MASS, BODY_FRICTION)
        _paint(body, cylinder, [half[0] - OUTLINE, 0.001, 0], GREY, (0, 0), 0.01)
        for side in (-1, 1):
            _add_finger(body, side)
    else:
        box = mujoco.mjtGeom.mjGEOM_BOX
        _collider(body, box, [*half, HEIGHT], DARK_GREY, ROBOT_MASS, BODY_FRICTION)
        _paint(body, box, [half[0] - OUTLINE, half[1] - OUTLINE, 0.001], GREY, (0, 0), 0.01)
    disc = mujoco.mjtGeom.mjGEOM_CYLINDER
    for side in (-1, 1):
        x, y = side * body_of.eyes[0], body_of.eyes[1]
        _paint(body, disc, [0.2 * RADIUS, 0.001, 0], WHITE, (x, y), 0.02)
        # the public package's pupils swing; these look ahead
        _paint(body, disc, [0.12 * RADIUS, 0.001, 0], BLACK, (x, y + 0.07 * RADIUS), 0.03)


def _add_finger(body: mujoco.MjsBody, side: int) -> None:
    """Add a finger of two bars: the outer one bends inwards by an eighth of a half turn."""
    thickness, upper, fore = 0.25 * RADIUS, 1.1 * RADIUS, 0.7 * RADIUS
    finger = body.add_body(name=_finger_name(side), pos=[side * 0.45 * RADIUS, 0.1 * RADIUS, 0])
    limits = [-FINGER_RANGE, 0.0] if side > 0 else [0.0, FINGER_RANGE]
    finger.add_joint(
        name=_finger_name(side), type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], range=limits
    )
    bend = side * np.pi / 8
    turn = np.array([[np.cos(bend), -np.sin(bend)], [np.sin(bend), np.cos(bend)]])
    start = np.array([side * thickness / 2, upper])  # outer corner of the upper bar's end
    middle = start + turn @ np.array([-side * thickness / 2, fore / 2])
    box = mujoco.mjtGeom.mjGEOM_BOX
    for length, (x, y), angle in ((upper, (0.0, upper / 2), 0.0), (fore, middle, bend)):
        mass = FINGER_MASS * length / (upper + fore)
        size = [thickness / 2, length / 2, HEIGHT]
        _collider(finger, box, size, GREY, mass, FINGER_FRICTION, (x, y), angle)
        inner = [thickness / 2 - 0.01, length / 2 - 0.01, 0.001]
        _paint(finger, box, inner, LIGHT_GREY, (x, y), 0.005, angle)


def _finger_name(side: int) -> str:
    return "right_finger" if side > 0 else "left_finger"


def _collider(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    rgba: Rgba,
    mass: float,
    friction: float,
    position: tuple[float, float] = (0.0, 0.0),
    angle: float = 0.0,
) -> None:
    body.add_geom(
        type=kind, size=size, rgba=rgba, mass=mass, friction=[friction, 0, 0],
        pos=[*position, 0], quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)],
        contype=ROBOT_BIT, conaffinity=0,
    )  # fmt: skip


def _paint(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    rgba: Rgba,
    position: tuple[float, float],
    above: float,
    angle: float = 0.0,
) -> None:
    """Add something flat that is only drawn, ``above`` m over what collides."""
    body.add_geom(
        type=kind, size=size, rgba=rgba, mass=0.0, contype=0, conaffinity=0,
        pos=[*position, HEIGHT + above], quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)],
    )  # fmt: skip
