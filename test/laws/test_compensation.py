"""Feed-forward from a drive model: derivatives of KE, and the motor torque that keeps the model's rotor equation."""

import math

import numpy as np
import pytest

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import torque
from hd_control.papers.baselines import DriveValues, friction, kinematic_error, motor_feedforward, motor_position

A, B = (0.5e-5, 5e-5, 0.2e-5, 1.5e-5), (0.3e-5, 2e-5, 0.1e-5, 0.8e-5)
DRIVE = DriveValues(
    gear_ratio=120.0, rotor_inertia=28.0, torsional_stiffness=2.9e5, coulomb_torque=24.0, friction_offset=3.0,
    viscous_positive=300.0, viscous_negative=330.0, load_friction_linear=3e-3, load_friction_quadratic=3.5e-6,
    kinematic_cosine=A, kinematic_sine=B,
)  # fmt: skip
LOAD = 40.0


def motion(t):
    """q and its derivatives up to the fourth, and the torque of an inertia LOAD with its two derivatives."""
    w = 4.0
    q, v, a = 0.2 * np.sin(w * t), 0.2 * w * np.cos(w * t), -0.2 * w**2 * np.sin(w * t)
    return q, v, a, LOAD * a, -LOAD * w**2 * v, -LOAD * w**2 * a


def test_slope_and_curvature_are_derivatives():
    angle, h = np.linspace(-7, 7, 101), 1e-4
    (left, slope_left, _), (right, slope_right, _) = kinematic_error(angle - h, A, B), kinematic_error(angle + h, A, B)
    _, slope, curvature = kinematic_error(angle, A, B)
    # central difference: error h^2/6 times the third derivative, at most 4^3 of the amplitude
    assert np.allclose((right - left) / (2 * h), slope, atol=1e-11, rtol=0)
    assert np.allclose((slope_right - slope_left) / (2 * h), curvature, atol=1e-11, rtol=0)


def test_python_and_compiled_kinematic_error_agree():
    values = load_params_file(config_path("torque_node.yaml"), "torque_node") | {"kinematic_feedforward": True}
    for n in range(4):
        values |= {f"kinematic_cosine_{n + 1}": [A[n]] * 7, f"kinematic_sine_{n + 1}": [B[n]] * 7}
    params = torque.configure(values, None, 1e-3)
    sample, reference = torque.new_sample(7), torque.new_reference(7)
    sample.motor_position = np.linspace(-2, 2, 7)
    reference.desired_velocity = 0.3
    output, _ = torque.step(params, torque.initial_state(params), sample, reference, 1e-3)
    angle = np.array(values["gear_ratio"]) * sample.motor_position
    error, slope, curvature = kinematic_error(angle, A, B)
    ratio = np.array(values["gear_ratio"])
    assert np.allclose(output.kinematic_error, error, atol=1e-18, rtol=1e-12)
    assert np.allclose(output.kinematic_error_rate, ratio * slope * 0.3, rtol=1e-11, atol=1e-18)
    assert np.allclose(output.kinematic_error_acceleration, ratio**2 * curvature * 0.09, rtol=1e-11, atol=1e-15)


def test_no_harmonics_means_no_error():
    assert kinematic_error(1.0, (), ()) == (0.0, 0.0, 0.0)


def test_rotor_motion_keeps_the_transmission():
    """phi + KE(N phi) - q = tau / k, and velocity and acceleration are its derivatives (central differences)."""
    h = 1e-5
    t = np.linspace(0.0, 2.0, 400)
    now, before, after = (motor_feedforward(DRIVE, *motion(x)) for x in (t, t - h, t + h))
    q, tau = motion(t)[0], motion(t)[3]
    error = kinematic_error(120.0 * now.motor_position, A, B)[0]
    assert np.abs(now.motor_position + error - q - tau / 2.9e5).max() < 1e-15
    assert np.abs((after.motor_position - before.motor_position) / (2 * h) - now.motor_velocity).max() < 1e-6
    assert np.abs((after.motor_velocity - before.motor_velocity) / (2 * h) - now.motor_acceleration).max() < 1e-4


def test_the_torque_keeps_the_rotor_equation():
    """u = I* phi'' + F + Y tau, with phi'' by finite differences and F, Y written out here."""
    h = 2e-5
    t = np.linspace(0.03, 2.0, 333)
    now, before, after = (motor_feedforward(DRIVE, *motion(x)) for x in (t, t - h, t + h))
    phi_a = (after.motor_position - 2 * now.motor_position + before.motor_position) / h**2
    v, tau = now.motor_velocity, motion(t)[3]
    grown = 1 + 3e-3 * np.abs(tau) + 3.5e-6 * tau**2
    resist = 24 * grown * np.tanh(v / 1e-3) + 3 + np.where(v > 0, 300, 330) * v
    theta = 120 * now.motor_position
    slope = sum(n * (B[n - 1] * np.cos(n * theta) - A[n - 1] * np.sin(n * theta)) for n in range(1, 5))
    u = 28 * phi_a + resist + (1 + 120 * slope) * tau
    # second difference: h^2/12 of the fourth derivative, 28 (2 * 120 * 0.8)^4 5e-5 = 2e6 N m/s^2, is 6e-5 N m;
    # four harmonics and the rounding 1e-16/h^2 together stay below 1e-3 N m of 340
    assert np.abs(u - now.motor_torque).max() < 1e-3


def test_a_perfect_gear_needs_the_textbook_torque():
    drive = DriveValues(gear_ratio=100.0, rotor_inertia=2.0)
    found = motor_feedforward(drive, 0.3, 0.1, 5.0, 7.0)
    assert found.motor_torque == pytest.approx(2.0 * 5.0 + 7.0, abs=1e-12)
    assert (found.motor_position, found.motor_velocity, found.motor_acceleration) == (0.3, 0.1, 5.0)


def test_damping_shifts_the_torsion_by_its_time():
    """At constant torque rate the torsion is that of the torque d earlier."""
    drive = DriveValues(gear_ratio=100.0, rotor_inertia=2.0, torsional_stiffness=1e4, damping_time=1e-3)
    found = motor_feedforward(drive, 0.0, 0.0, 0.0, 10.0, 50.0)
    assert found.motor_position == pytest.approx((10.0 - 0.05) / 1e4, rel=1e-12)
    assert found.motor_velocity == pytest.approx(50.0 / 1e4, rel=1e-12)


def test_friction_is_smooth_odd_and_grows_with_load():
    plain = DriveValues(
        gear_ratio=1.0, rotor_inertia=1.0, coulomb_torque=10.0, viscous_positive=5.0, viscous_negative=5.0,
        load_friction_linear=0.01, friction_width=0.01,
    )  # fmt: skip
    v = np.linspace(-1, 1, 2001)
    f = friction(plain, v, 50.0)
    assert np.allclose(f, -friction(plain, -v, -50.0), atol=1e-12)
    assert np.abs(np.diff(f)).max() < 15.0 / 0.01 * 1e-3 + 5e-3 + 1e-9
    assert f[-1] == pytest.approx(15.0 * math.tanh(100.0) + 5.0)
    assert friction(plain, 0.0, 0.0) == 0.0


def test_any_shape():
    q = np.full((3, 2), 0.1)
    found = motor_feedforward(DRIVE, q, q, q, 10.0 * q)
    assert found.motor_torque.shape == (3, 2)
    assert np.ptp(found.motor_torque) == 0.0
    assert motor_position(DRIVE, 0.1, 0.0).shape == ()
