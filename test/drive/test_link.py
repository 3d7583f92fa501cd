"""Link dynamics of all samples at once against Pinocchio, one sample after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot
from hd_control.drive.link import added_bodies, arm_terms, link_terms, own_link, single_inertia, torques
from hd_control.drive.model import JointModel, Model, ModelValue, model_from_urdf

ROBOTS = ("arm_a", "arm_c", "single_joint_3")
BODY_MASS, BODY_CENTER, BODY_INERTIA = 3.0, np.array([0.1, -0.2, 0.3]), np.diag([0.1, 0.2, 0.25])


def motion(robot: Robot, rng: np.random.Generator, n: int = 20) -> np.ndarray:
    """Random positions, velocities, accelerations (3, n, J)."""
    return rng.normal(size=(3, n, robot.joints))


@pytest.mark.parametrize("name", ROBOTS)
def test_torques_are_pinocchios(name: str, rng: np.random.Generator) -> None:
    robot = Robot.from_file(name)
    q, v, a = motion(robot, rng)
    model = robot.pinocchio_model()
    data = model.createData()
    expected = np.array([pinocchio.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(torques(robot, q, v, a, 9.81), expected, atol=1e-11)
    for j, joint in enumerate(robot.joint_names):
        inertia, bias, _, _ = link_terms(model_from_urdf(name, 100.0), joint, q, v, a)
        np.testing.assert_allclose(inertia + bias, expected[:, j], atol=1e-11)
        mass = np.array([pinocchio.crba(model, data, row)[j] for row in q])
        mass = np.where(
            np.arange(robot.joints) >= j, mass, np.array([pinocchio.crba(model, data, row)[:, j] for row in q])
        )
        np.testing.assert_allclose(inertia, np.einsum("nj,nj->n", mass, a), atol=1e-11)


@pytest.mark.parametrize("name", ROBOTS)
def test_regressors_are_the_torque_of_an_added_body(name: str, rng: np.random.Generator) -> None:
    robot = Robot.from_file(name)
    q, v, a = motion(robot, rng)
    before = torques(robot, q, v, a, 9.81)
    last = robot.joints - 1
    at_origin = BODY_INERTIA + _apart(BODY_MASS, BODY_CENTER)
    entries = [at_origin[i] for i in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    parameters = np.array([BODY_MASS, *(BODY_MASS * BODY_CENTER), *entries])
    for j, joint in enumerate(robot.joint_names):
        _, _, own, tool = link_terms(model_from_urdf(name, 100.0), joint, q, v, a)
        assert own is not None and tool is not None
        for body, regressor in ((j, own), (last, tool)):
            added = torques(_with_body(robot, body), q, v, a, 9.81) - before
            np.testing.assert_allclose(regressor @ parameters, added[:, j], atol=1e-10)


def test_what_the_model_adds_stands_in_the_order_of_the_regressor() -> None:
    values = {"tool_mass": ModelValue(2.0), "tool_moment_y": ModelValue(0.3), "link_inertia_yz": ModelValue(0.5)}
    joint = JointModel(100.0, None, {"payload": values, "link_dynamics": {"inertia": ModelValue(4.0)}})
    own, last = added_bodies(joint)
    np.testing.assert_array_equal(own, [*[0.0] * 8, 0.5, 0.0])
    np.testing.assert_array_equal(last, [2.0, 0.0, 0.3, *[0.0] * 7])
    assert single_inertia(joint) == 4.0
    bare = JointModel(100.0)
    assert not np.any(added_bodies(bare)) and single_inertia(bare) == 0.0


def _apart(mass: float, arm: np.ndarray) -> np.ndarray:
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def _with_body(robot: Robot, link: int) -> Robot:
    """The robot with the body fixed to one link."""
    mass, center, inertia = robot.mass.copy(), robot.center_of_mass.copy(), robot.inertia.copy()
    whole = mass[link] + BODY_MASS
    middle = (mass[link] * center[link] + BODY_MASS * BODY_CENTER) / whole
    inertia[link] += _apart(mass[link], center[link] - middle) + BODY_INERTIA + _apart(BODY_MASS, BODY_CENTER - middle)
    mass[link], center[link] = whole, middle
    return replace(robot, mass=mass, center_of_mass=center, inertia=inertia)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_own_link_is_the_whole_arm_on_its_measured_path(name: str, rng: np.random.Generator) -> None:
    robot = Robot.from_file(name)
    q, v, a = motion(robot, rng)
    model = model_from_urdf(name, 100.0)
    scaled = {"inertia_scale": ModelValue(1.2)}
    model = model.with_effect(robot.joint_names[-1], "link_dynamics", scaled)
    for j, joint in enumerate(robot.joint_names):
        own = own_link(model, joint, q, v, a)
        inertia, bias, _, _ = link_terms(model, joint, q, v, a)
        np.testing.assert_allclose(own.inertia * a[:, j] + own.rest, inertia + bias, atol=1e-10)
        assert (own.inertia > 0.0).all()
        step, still = np.zeros_like(q), np.zeros_like(q)
        step[:, j] = 1e-3
        ahead, back = (torques(robot, q + sign * step, still, still, 9.81)[:, j] for sign in (1.0, -1.0))
        # third derivative of gravity (below 1000 N m/rad^3) times (1e-3)^3 / 3
        np.testing.assert_allclose(own.slope * 2e-3, ahead - back, atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_all_joints_at_once_are_each_alone(name: str, rng: np.random.Generator) -> None:
    robot = Robot.from_file(name)
    q, v, a = motion(robot, rng)
    model = model_from_urdf(name, 100.0).with_effect("joint_3", "link_dynamics", {"inertia_scale": ModelValue(0.9)})
    together = arm_terms(model, q, v, a)
    assert list(together) == list(robot.joint_names)
    for joint in robot.joint_names:
        for one, other in zip(link_terms(model, joint, q, v, a), together[joint], strict=True):
            np.testing.assert_array_equal(one, other)
    plain = link_terms(model_from_urdf(name, 100.0), "joint_3", q, v, a)
    np.testing.assert_allclose(together["joint_3"][0], 0.9 * plain[0], rtol=1e-14)
    np.testing.assert_array_equal(together["joint_3"][1], plain[1])


def test_a_single_joint_without_description() -> None:
    numbers = {"inertia": ModelValue(40.0), "gravity_sine": ModelValue(-120.0), "gravity_cosine": ModelValue(5.0)}
    model = Model(None, {"joint_3": JointModel(120.0, effects={"link_dynamics": numbers})})
    q, a = np.array([0.3, -0.4]), np.array([1.0, 2.0])
    inertia, bias, own, tool = link_terms(model, "joint_3", q, np.zeros(2), a)
    np.testing.assert_allclose(inertia, 40.0 * a)
    np.testing.assert_allclose(bias, -120.0 * np.sin(q) + 5.0 * np.cos(q))
    assert own is None and tool is None
    link = own_link(model, "joint_3", q, np.zeros(2), a)
    np.testing.assert_allclose(link.inertia * a + link.rest, inertia + bias, rtol=1e-14)
    np.testing.assert_allclose(link.slope, -120.0 * np.cos(q) - 5.0 * np.sin(q), rtol=1e-12)
    described = load_single(q, a)
    np.testing.assert_allclose(described[0], 40.0 * a, rtol=1e-9)
    np.testing.assert_allclose(described[1], -120.0 * np.sin(q), rtol=1e-9)


def load_single(q: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same joint from its description: J = 40 kg m^2, 120 N m, centre of mass above the axis."""
    return link_terms(model_from_urdf("single_joint_3", 120.0), "joint_3", q, np.zeros(2), a)[:2]


def test_wrong_motion_is_refused() -> None:
    q = np.zeros((4, 1))
    with pytest.raises(ConfigError, match="7 joints"):
        link_terms(model_from_urdf("arm_a", 120.0), "joint_3", q, q, q)
    with pytest.raises(ConfigError, match="inertia"):
        link_terms(Model(None, {"a": JointModel(1.0)}), "a", q, q, q)
