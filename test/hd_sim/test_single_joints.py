"""The papers' single joints: compiled world against the equations written down once more, and against closed forms."""

import math

import numpy as np
import pytest
from oracles.manifold_law import Joint

from hd_control.papers.gandhi_runs import Experiment, plant_values
from hd_control.papers.rows import load_constants
from hd_sim.paper_joints import Diaphragm, GaugeBridge, GearJoint, OneLinkArm

ARM = {
    "rotor_inertia": 0.94, "link_inertia": 0.88, "stiffness": 8800.0, "coulomb_torque": 0.0,
    "presliding_distance": 2e-5, "bristle_damping": 0.3, "viscous": 0.0,
}  # fmt: skip


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("phase", [0.0, 1.1])
def test_gear_joint_is_8_to_10(nonlinear, phase):
    """Hysteresis as a state here, by its exact solution there; the same motion to the step's own error."""
    c = load_constants("gandhi")
    given = plant_values(c, Experiment(nonlinear=nonlinear, phase=phase))
    turn = phase * np.arange(1, 5)
    a, b = np.array(c["kinematic_cosine"]), np.array(c["kinematic_sine"])
    other = Joint(
        J_m=given["rotor_inertia"], B_m=given["rotor_damping"], J_l=given["link_inertia"], B_l=given["link_damping"],
        N=50.0, A=given["hysteresis_stiffness"], alpha=given["hysteresis_rate"],
        a=a * np.cos(turn) + b * np.sin(turn), b=b * np.cos(turn) - a * np.sin(turn),
    )  # fmt: skip

    def spring(x):
        return given["stiffness_linear"] * x + given["stiffness_cubic"] * x**3 + given["stiffness_quintic"] * x**5

    def rates(state, t, u):
        return other.plant_rates(state, u, 30.0 * math.sin(given["load_frequency"] * t), spring)

    joint, state, h = GearJoint(given), np.zeros(5), 5e-6
    for k in range(20000):
        u, t = 0.6 * math.sin(40 * k * h) + 0.2, k * h
        joint.advance(50.0 * u, h)
        start = state.copy()
        one = rates(start, t, u)
        two = rates(start + h / 2 * one, t + h / 2, u)
        three = rates(start + h / 2 * two, t + h / 2, u)
        four = rates(start + h * three, t + h, u)
        state = start + h / 6 * (one + 2 * two + 2 * three + four)
    link, link_rate, torque, motor, motor_rate, _ = joint.measured
    assert abs(state[2]) > 0.02 and abs(state[4]) > 0.1
    assert link == pytest.approx(state[2], abs=1e-7)
    assert motor == pytest.approx(state[0] / 50.0, abs=1e-7)
    assert (link_rate, motor_rate) == pytest.approx((state[3], state[1] / 50.0), abs=2e-5)
    assert -torque - spring(joint.wind_up) == pytest.approx(state[4], abs=2e-3), "hysteresis"


def test_locked_arm_swings_with_the_springs_own_frequency():
    arm, seen = OneLinkArm({**ARM, "link_inertia": 0.0}), []
    for _ in range(4000):
        arm.advance(5.0, 2.5e-5, 1)
        seen.append(arm.measured[2])
    time = 2.5e-5 * np.arange(1, 4001)
    np.testing.assert_allclose(seen, 5.0 * (1.0 - np.cos(math.sqrt(8800.0 / 0.94) * time)), atol=0.02)


def test_free_arm_keeps_its_momentum():
    arm = OneLinkArm(ARM)
    arm.advance(3.0, 2.5e-5, 8000)
    total = 0.94 * arm.measured[4] + 0.88 * arm.measured[1]
    assert total == pytest.approx(3.0 * 0.2, rel=1e-9)


def test_friction_holds_until_it_breaks():
    arm = OneLinkArm({**ARM, "link_inertia": 0.0, "coulomb_torque": 4.0})
    arm.advance(1.0, 2.5e-5, 20000)
    assert abs(arm.measured[2]) < 8800.0 * 2e-5  # the bristle's travel holds it
    arm.advance(12.0, 2.5e-5, 80000)
    assert 4.0 < arm.measured[2] < 16.0


def test_gauge_strain_is_the_closed_form_7():
    t, r1, r2, shear = 0.39e-3, 15.8e-3, 24.85e-3, 8.3e10
    wanted = (r1 + r2) / (8 * math.pi * t * shear * r1**2 * r2)
    assert Diaphragm(t, r1, r2, shear).gauge_strain(1.0) == pytest.approx(wanted, rel=1e-8)


def test_bridge_cancels_what_all_gauges_share():
    bridge = GaugeBridge(2.1, 120.0, 3.0, 5e-6, 1e-4, apparent_strain=(1e-6,) * 4)
    cold, warm = (
        bridge.output(np.array([10.0]), np.array([0.4])),
        bridge.output(np.array([10.0]), np.array([0.4]), 40.0),
    )
    assert warm[0] == pytest.approx(cold[0], rel=2e-4)  # only the gain changes, by the strain itself
    assert bridge.output(np.array([0.0]), np.array([0.4]), 40.0)[0] == pytest.approx(0.0, abs=1e-15)
