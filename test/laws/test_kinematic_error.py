"""The compiled kinematic error and its rates against a re-statement whose slopes are checked here."""

import numpy as np
from oracles.kinematic_error import kinematic_error

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import torque

A, B = (0.5e-5, 5e-5, 0.2e-5, 1.5e-5), (0.3e-5, 2e-5, 0.1e-5, 0.8e-5)


def test_slope_and_curvature_are_derivatives():
    angle, h = np.linspace(-7, 7, 101), 1e-4
    (left, slope_left, _), (right, slope_right, _) = kinematic_error(angle - h, A, B), kinematic_error(angle + h, A, B)
    _, slope, curvature = kinematic_error(angle, A, B)
    # central difference: error h^2/6 times the third derivative, at most 4^3 of the amplitude
    assert np.allclose((right - left) / (2 * h), slope, atol=1e-11, rtol=0)
    assert np.allclose((slope_right - slope_left) / (2 * h), curvature, atol=1e-11, rtol=0)


def test_the_compiled_kinematic_error_and_its_rates():
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
