"""Robot arms from the MJCF files in the robosuite wheel (MIT), which is read, not imported."""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import CorruptFileError, UnknownNameError

COLLISION_GROUP, VISUAL_GROUP, UNDRAWN_GROUP = 0, 1, 3


@dataclass(frozen=True)
class GripperConfig:
    """A gripper with two fingers that slide apart."""

    file: str
    joints: tuple[str, ...]
    directions: tuple[float, ...]
    """Change of each of ``joints`` a m of opening."""
    stiffness: float
    """N/m of the servos."""
    damping: float
    """N s/m."""

    def positions(self, opening: float) -> NDArray[np.float64]:
        """Return the joints' positions (J,) in m with each finger ``opening`` m from the middle."""
        return opening * np.array(self.directions)

    def opening(self, positions: NDArray[np.float64]) -> float:
        """Return the mean distance in m of the fingers from the middle."""
        return float(np.mean(positions / np.array(self.directions)))


@dataclass(frozen=True)
class RobotConfig:
    """An arm with a gripper that points down."""

    name: str
    arm_file: str
    flange: str
    """Body of the arm that carries the gripper."""
    arm_joints: tuple[str, ...]
    home: tuple[float, ...]
    """rad; the posture towards which the null space of the arm is drawn."""
    stiffness: tuple[float, ...]
    """N m/rad of the position actuators, from the trial's gains that track without ringing."""
    damping: tuple[float, ...]
    """N m s/rad."""
    gripper: GripperConfig


PANDA_GRIPPER = GripperConfig(
    file="grippers/panda_gripper.xml",
    joints=("finger_joint1", "finger_joint2"),
    directions=(1.0, -1.0),
    stiffness=1000.0,
    damping=50.0,
)

ROBOTS = {
    "panda": RobotConfig(
        name="panda",
        arm_file="robots/panda/robot.xml",
        flange="right_hand",
        arm_joints=tuple(f"joint{i}" for i in range(1, 8)),
        home=(0.0, np.pi / 16, 0.0, -np.pi / 2 - np.pi / 3, 0.0, np.pi - 0.2, -np.pi / 4),
        stiffness=(600, 600, 600, 600, 250, 150, 50),
        damping=(50, 50, 50, 50, 30, 25, 15),
        gripper=PANDA_GRIPPER,
    ),
    # robosuite's model: link lengths of the iiwa 7 R800. The gripper is the Panda's, so that the
    # two robots differ in the arm alone.
    "iiwa": RobotConfig(
        name="iiwa",
        arm_file="robots/iiwa/robot.xml",
        flange="right_hand",
        arm_joints=tuple(f"joint_{i}" for i in range(1, 8)),
        home=(0.0, 0.65, 0.0, -1.89, 0.0, 0.6, 0.0),
        # its links are heavier than the Panda's: softer servos overshoot by centimetres
        stiffness=(6000,) * 7,
        damping=(300,) * 7,
        gripper=PANDA_GRIPPER,
    ),
}


def get_robot(name: str) -> RobotConfig:
    """Return a robot by name.

    :raises UnknownNameError: if there is none of that name.
    """
    if name not in ROBOTS:
        raise UnknownNameError("robot", name, ROBOTS)
    return ROBOTS[name]


def asset_folder() -> Path:
    """Return the folder of robot models in the installed robosuite wheel.

    :raises CorruptFileError: if the wheel is not installed or lacks its models.
    """
    try:
        folder = Path(str(distribution("robosuite").locate_file("robosuite/models/assets")))
    except PackageNotFoundError as error:
        raise CorruptFileError(
            "robot models not found: install them with `pip install --no-deps robosuite==1.5.2`"
        ) from error
    if not (folder / "robots").is_dir():
        raise CorruptFileError(f"no robot models in {folder}, expected robots/ and grippers/")
    return folder


def robot_spec(robot: RobotConfig) -> mujoco.MjSpec:
    """Return arm and gripper in one spec: gravity compensated, position controlled.

    Only gripper and fingers collide: nothing else of the arm comes near an object.
    """
    assets = asset_folder()
    arm = mujoco.MjSpec.from_file(str(assets / robot.arm_file))
    gripper = mujoco.MjSpec.from_file(str(assets / robot.gripper.file))
    for spec in (arm, gripper):
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for camera in list(spec.cameras):
            spec.delete(camera)
        for site in spec.sites:
            site.rgba = [0, 0, 0, 0]
        for geom in spec.geoms:
            if geom.group == COLLISION_GROUP:
                geom.rgba = [0, 0, 0, 0]
                geom.group = UNDRAWN_GROUP
    for geom in arm.geoms:
        geom.contype = geom.conaffinity = 0
    arm.body(robot.flange).add_frame().attach_body(gripper.body("right_gripper"), "gripper_", "")
    for body in arm.bodies:
        body.gravcomp = 1.0
    for name, stiffness, damping in zip(
        robot.arm_joints, robot.stiffness, robot.damping, strict=True
    ):
        add_position_actuator(arm, name, stiffness, damping)
    for joint in robot.gripper.joints:
        add_position_actuator(
            arm, f"gripper_{joint}", robot.gripper.stiffness, robot.gripper.damping
        )
    return arm


def add_position_actuator(
    spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float
) -> None:
    """Add a position servo: force = stiffness (ctrl - q) - damping q'."""
    actuator = spec.add_actuator()
    actuator.name = joint
    actuator.target = joint
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0] = stiffness
    actuator.biasprm[1] = -stiffness
    actuator.biasprm[2] = -damping
