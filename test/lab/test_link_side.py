"""Link terms along a recording against Pinocchio, which knows gravity and inertia of an arm by itself."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio
import pytest
from plain_joint import NAME, PLAIN, joint_model, model, signals

from hd_control.core.errors import BagError
from hd_control.core.robot import Robot
from hd_control.drive.model import Model, ModelValue, model_from_urdf
from hd_control.lab.balances.link import LinkSide, link_torque
from hd_control.lab.balances.states import JOINT_TAPER
from hd_control.lab.signals.filters import Band, Spectral
from hd_control.lab.signals.joint_signals import JointSignals

PERIOD, ROWS, RATIO = 2e-3, 6000, 100.0
BAND = Band(30.0, 40.0, 6)
ROBOT = Robot.from_file("arm_a")
JOINTS = ROBOT.joint_names
INSIDE = slice(60, -60)


@lru_cache(maxsize=1)
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, q', q'' (n, J) of sines up to 4 Hz, which every filter here lets through whole."""
    time = np.arange(ROWS) * PERIOD
    q, v, a = (np.zeros((ROWS, ROBOT.joints)) for _ in range(3))
    for j in range(ROBOT.joints):
        for f in (0.23 + 0.05 * j, 1.1 + 0.1 * j, 3.9 - 0.2 * j):
            w, size = 2.0 * np.pi * f, 0.4 / (1.0 + f**2)
            q[:, j] += size * np.sin(w * time + j + f)
            v[:, j] += size * w * np.cos(w * time + j + f)
            a[:, j] -= size * w**2 * np.sin(w * time + j + f)
    return q, v, a


def recorded(motor: bool = False) -> dict[str, JointSignals]:
    """Every joint of the arm; of the motors alone if asked so."""
    time, q = np.arange(ROWS) * PERIOD, motion()[0]
    name, scale = ("motor_shaft_position", RATIO) if motor else ("joint_position", 1.0)
    return {
        joint: JointSignals(joint, time, PERIOD, np.ones(ROWS, bool), **{name: scale * q[:, j]})
        for j, joint in enumerate(JOINTS)
    }


def rnea(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Joint torques (n, J) by Pinocchio."""
    arm = robot.pinocchio_model()
    data = arm.createData()
    return np.array([pinocchio.rnea(arm, data, *row) for row in zip(q, v, a, strict=True)])


@lru_cache(maxsize=1)
def expected() -> tuple[np.ndarray, np.ndarray]:
    """Torque of the inertia and the rest (rows, J), at the rows of the band."""
    q, v, a = (x[:: BAND.step] for x in motion())
    whole, rest = rnea(ROBOT, q, v, a), rnea(ROBOT, q, v, 0.0 * a)
    return whole - rest, rest


@pytest.mark.parametrize("motor", [False, True])
def test_inertia_and_bias_of_every_joint_are_pinocchios(motor: bool) -> None:
    """The sums of the derivatives' errors in the filters, 2e-3 of the largest torque."""
    side = LinkSide(model_from_urdf("arm_a", RATIO), recorded(motor))
    spectral = Spectral(ROWS, PERIOD)
    for j, joint in enumerate(JOINTS):
        function = side.function(joint)
        assert function is not None
        inertia, bias, own, tool = function(BAND, spectral)
        for found, true in ((inertia, expected()[0][:, j]), (bias, expected()[1][:, j])):
            scale = max(np.abs(expected()[0][:, j]).max(), np.abs(expected()[1][:, j]).max())
            np.testing.assert_allclose(found[INSIDE], true[INSIDE], atol=2e-3 * scale)
        assert own is not None and tool is not None and own.shape == tool.shape == (inertia.size, 10)


def test_regressors_are_what_a_body_adds_without_accelerations() -> None:
    """A point mass at the last link, by Pinocchio: with the motion but at zero acceleration."""
    j = ROBOT.joints - 2
    place, mass = np.array([0.05, -0.1, 0.2]), 2.0
    arm = ROBOT.pinocchio_model()
    arm.inertias[ROBOT.joints] = arm.inertias[ROBOT.joints] + pinocchio.Inertia(mass, place, np.zeros((3, 3)))
    data = arm.createData()
    q, v, a = (x[:: BAND.step] for x in motion())
    added = np.array([pinocchio.rnea(arm, data, *row) for row in zip(q, v, 0.0 * a, strict=True)]) - expected()[1]
    function = LinkSide(model_from_urdf("arm_a", RATIO), recorded()).function(JOINTS[j])
    assert function is not None
    _, _, _, tool = function(BAND, Spectral(ROWS, PERIOD))
    assert tool is not None
    x, y, z = place
    moment = mass * np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    found = tool @ np.concatenate([[mass], mass * place, moment])
    np.testing.assert_allclose(found[INSIDE], added[INSIDE, j], atol=3e-3 * np.abs(added[:, j]).max())


def test_a_payload_of_the_model_counts_in_inertia_and_torque() -> None:
    """1.5 kg in the origin of the last link's frame: link_torque is that of the loaded arm."""
    joint, mass = JOINTS[1], 1.5
    plain = model_from_urdf("arm_a", RATIO)
    loaded = plain.with_effect(joint, "payload", {"tool_mass": ModelValue(mass, "kg")})
    arm = ROBOT.pinocchio_model()
    arm.inertias[ROBOT.joints] = arm.inertias[ROBOT.joints] + pinocchio.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    data = arm.createData()
    q, v, a = motion()
    true = np.array([pinocchio.rnea(arm, data, *row)[1] for row in zip(q, v, a, strict=True)])
    torque, velocity = link_torque(loaded, recorded(), joint)
    inside = slice(300, -300)
    np.testing.assert_allclose(torque[inside], true[inside], atol=3e-3 * np.abs(true).max())
    np.testing.assert_allclose(velocity[inside], v[inside, 1], atol=2e-3 * np.abs(v[:, 1]).max())
    light, _ = link_torque(plain, recorded(), joint)
    assert np.abs(torque - light)[inside].max() > 0.05 * np.abs(true).max()


def test_the_own_link_of_a_prediction_is_pinocchios() -> None:
    """Own inertia is the diagonal of the mass matrix, slope the change of gravity with the own angle."""
    j = 1
    own = LinkSide(model_from_urdf("arm_a", RATIO), recorded()).own_link(JOINTS[j], Spectral(ROWS, PERIOD))
    assert own is not None
    arm = ROBOT.pinocchio_model()
    data = arm.createData()
    q, v, a = motion()
    rows = np.arange(400, ROWS - 400, 500)
    for k in rows:
        inertia = pinocchio.crba(arm, data, q[k])[j, j]
        whole = pinocchio.rnea(arm, data, q[k], v[k], a[k])[j]
        moved = q[k] + 1e-5 * np.eye(ROBOT.joints)[j]
        gravity = [pinocchio.computeGeneralizedGravity(arm, data, x)[j] for x in (q[k], moved)]
        assert own.inertia[k] == pytest.approx(inertia, rel=1e-3)
        assert own.inertia[k] * a[k, j] + own.rest[k] == pytest.approx(whole, abs=3e-3 * np.abs(expected()[1]).max())
        assert own.slope[k] == pytest.approx((gravity[1] - gravity[0]) / 1e-5, abs=0.05)


def test_a_single_joint_needs_inertia_and_gravity_only() -> None:
    """J q'' and g sin q of the plain joint, whose simulation obeys them."""
    recordings = {NAME: signals(noisy=False)}
    torque, _ = link_torque(model(), recordings, NAME)
    whole, inside = signals(noisy=False).gauge_torque, slice(600, -600)
    # Both sides through the same filter. The sine of a filtered angle is not the filtered sine: 1e-4 of the gravity.
    seen = Spectral(whole.size, 1e-3).filter(whole, Band(*JOINT_TAPER))
    np.testing.assert_allclose(torque[inside], seen[inside], atol=2e-4 * PLAIN.gravity)
    side = LinkSide(model(), recordings)
    function = side.function(NAME)
    assert function is not None and side.why_not(NAME) == ""
    own = side.own_link(NAME, Spectral(whole.size, 1e-3))
    assert own is not None
    np.testing.assert_allclose(own.inertia, PLAIN.link_inertia)
    np.testing.assert_allclose(own.slope[inside], PLAIN.gravity * np.cos(signals(noisy=False).joint_position)[inside],
                               rtol=1e-4)  # fmt: skip


def test_what_stands_in_the_way_is_said() -> None:
    arm, records = model_from_urdf("arm_a", RATIO), recorded()
    bare = Model(None, {NAME: joint_model(without=("link_dynamics",))})
    cases = (
        (LinkSide(arm, records), "elbow", "elbow: the robot description has no such joint"),
        (
            LinkSide(bare, {NAME: signals()}),
            NAME,
            "joint_1: the model knows neither robot description nor link inertia",
        ),
        (
            LinkSide(arm, {n: s for n, s in records.items() if n != JOINTS[2]}),
            JOINTS[0],
            f"link dynamics needs the motion of all joints; {JOINTS[2]} is not recorded",
        ),
    )
    for side, joint, says in cases:
        assert side.why_not(joint) == says
        assert side.function(joint) is None and side.own_link(joint, Spectral(ROWS, PERIOD)) is None
    with pytest.raises(BagError, match="no such joint; the joint torque cannot be computed"):
        link_torque(arm, {**records, "elbow": records[JOINTS[0]]}, "elbow")
    with pytest.raises(BagError, match="its joint position is not recorded"):
        link_torque(model(), {NAME: replace(signals(), joint_position=None)}, NAME)


def test_all_joints_of_one_band_are_computed_together() -> None:
    side, spectral = LinkSide(model_from_urdf("arm_a", RATIO), recorded()), Spectral(ROWS, PERIOD)
    first, second = (side.function(joint) for joint in JOINTS[:2])
    assert first is not None and second is not None
    first(BAND, spectral)
    assert set(side._terms[(BAND.flat, BAND.zero, BAND.step)]) == set(JOINTS)
    once = side._terms[(BAND.flat, BAND.zero, BAND.step)][JOINTS[1]]
    assert second(BAND, spectral) is once
