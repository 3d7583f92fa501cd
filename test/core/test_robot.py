"""The robot description: published table values, frame conversion, refusals."""

import numpy as np
import pinocchio
import pytest

from hd_control.core.errors import ConfigError, RobotError
from hd_control.core.robot import Robot

POSES = {
    "arm_a": [0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3],
    "arm_b": [0.2, 0.3, 1.3, 0.8, -0.5, 0.4, 0.3],
    "arm_c": [0.2, 0.7, 0.3, -1.0, 0.4, 0.8, 0.1],
}
GRAVITY_TORQUE = {  # N m, five digits
    "arm_a": [0, 503.1249, 51.6914, -32.6241, 1.1671, 5.9695, -1.6293],
    "arm_b": [0, -24.3693, -11.4020, -90.9979, -3.7046, -1.1185, -0.2686],
    "arm_c": [0, -72.95505, -1.51124, 9.09687, -0.41957, -2.52478, 0.11777],
}
INERTIA_DIAGONAL = {  # kg m^2
    "arm_a": [63.9874, 83.2410, 64.3625, 21.1501, 1.9338, 0.9611, 0.4104],
    "arm_b": [3.9923, 75.3916, 73.4500, 23.6333, 2.8882, 1.2723, 0.4104],
    "arm_c": [1.67833, 7.75664, 0.89776, 1.37426, 0.05802, 0.06701, 0.0035],
}


@pytest.mark.parametrize("name", POSES)
def test_shipped_arms_have_the_tabulated_gravity_and_inertia(name):
    model = Robot.from_file(name).pinocchio_model()
    data = model.createData()
    pose = np.array(POSES[name])
    gravity = pinocchio.computeGeneralizedGravity(model, data, pose)
    diagonal = np.diag(pinocchio.crba(model, data, pose))
    np.testing.assert_allclose(gravity, GRAVITY_TORQUE[name], atol=6e-5)
    np.testing.assert_allclose(diagonal, INERTIA_DIAGONAL[name], atol=6e-5)


def _tilted_arm(axis: str) -> str:
    inertia = "<inertia ixx='.4' iyy='.5' izz='.6' ixy='.01' ixz='.02' iyz='.03'/>"
    link = f"<inertial><origin xyz='.1 .2 .3'/><mass value='2'/>{inertia}</inertial>"
    joints = "".join(
        f"<joint name='j{i}' type='revolute'><parent link='l{i}'/><child link='l{i + 1}'/>"
        f"<origin xyz='.1 .2 .4' rpy='.3 -.4 .5'/><axis xyz='{axis}'/>"
        "<limit lower='-2' upper='2' velocity='1' effort='10'/></joint>"
        for i in range(3)
    )
    links = "<link name='l0'/>" + "".join(f"<link name='l{i + 1}'>{link}</link>" for i in range(3))
    return f"<robot name='tilted'>{links}{joints}</robot>"


@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0", "0 0 1", "0 0 -1", "0.6 0 0.8", "-0.36 0.48 0.8"])
def test_frames_with_z_along_the_axis_describe_the_same_arm(axis):
    """Gravity torque from the converted frames equals Pinocchio's on the original, for any joint axis."""
    robot = Robot.from_urdf(_tilted_arm(axis))
    model = robot.pinocchio_model()
    pose = np.array([0.7, -1.1, 0.4])
    expected = pinocchio.computeGeneralizedGravity(model, model.createData(), pose)
    np.testing.assert_allclose(_gravity_torque(robot, pose), expected, atol=1e-12)


def _gravity_torque(robot: Robot, pose: np.ndarray) -> np.ndarray:
    """Moments of the weights about the joint axes, from positions in the base frame only."""
    turn, place = np.eye(3), np.zeros(3)
    axes, places, centers = [], [], []
    for j in range(robot.joints):
        place = place + turn @ robot.origin[j]
        c, s = np.cos(pose[j]), np.sin(pose[j])
        turn = turn @ robot.rotation[j] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        axes.append(turn[:, 2])
        places.append(place)
        centers.append(place + turn @ robot.center_of_mass[j])
    up = np.array([0, 0, 9.81])
    return np.array(
        [
            sum(robot.mass[k] * axes[j] @ np.cross(centers[k] - places[j], up) for k in range(j, robot.joints))
            for j in range(robot.joints)
        ]
    )


def test_link_parameters_of_a_known_link():
    theta = Robot.from_file("arm_a").link_parameters()[2]
    m, x, z = 20, 0.35, 0.02
    expected = [m, m * x, 0, m * z, m * x * x, 0, m * z * z, 0, m * x * z - 0.05, 0, 0.12, 1.2, 1.2]
    np.testing.assert_allclose(theta, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("not xml", "not a usable URDF"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><robot name='x'/>", "DOCTYPE"),
        ("<robot name='x'><link name='a'/></robot>", "0 moving joints"),
        (_tilted_arm("0 0 1").replace("revolute", "prismatic"), "prismatic|JointModel|not supported|PZ"),
        (_tilted_arm("0 0 1").replace("<mass value='2'/>", "<mass value='0'/>"), "has no mass"),
    ],
)
def test_unusable_descriptions_are_refused_with_a_reason(text, says):
    with pytest.raises(RobotError, match=says):
        Robot.from_urdf(text)


def test_unknown_robot_names_what_exists():
    with pytest.raises(ConfigError, match=r"arm_a\.urdf"):
        Robot.from_file("arm_x")


def test_unknown_joint_is_named():
    with pytest.raises(RobotError, match="joint_9"):
        Robot.from_file("arm_a").indices(["joint_1", "joint_9"])
