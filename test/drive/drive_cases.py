"""States of a drive for tests: at rest, and along a smooth trajectory with every signal alive."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.drive.effect import Context, DriveStates

CONTEXT = Context(torsional_stiffness=3e5, coulomb_torque=24.0, torque_scale=150.0)

EXAMPLES: dict[str, list[dict[str, float]]] = {
    "rotor_inertia": [{"rotor_inertia": 28.0}],
    "torsional_stiffness": [{"torsional_stiffness": 2.9e5, "damping_time": 1e-3, "transmission_zero": 2e-4}],
    "coulomb_friction": [{"coulomb_torque": 24.0}],
    "viscous_friction": [{"viscous": 300.0}],
    "link_dynamics": [
        {"inertia_scale": 1.1},
        {"inertia_scale": 1.0, "inertia": 40.0, "gravity_cosine": 3.0, "gravity_sine": -120.0},
    ],
    "kinematic_error": [
        {"cosine_2": 1e-5, "sine_2": -2e-5},
        {"cosine_1": 1e-6, "sine_1": 0.0, "cosine_2": 1e-5, "sine_2": -2e-5, "cosine_4": 0.0, "sine_4": 3e-6},
    ],
    "torsional_hysteresis": [{"hysteresis_stiffness": 34800.0, "hysteresis_rate": 4000.0}],
    "nonlinear_stiffness": [
        {"stiffness_cubic": 4e11},
        {"windup_depth": 5e-5, "windup_width": 2e-4, "windup_steepening": 0.4},
    ],
    "backlash": [{"half_gap": 4e-5, "crossing_torque": 1.5}],
    "load_dependent_friction": [
        {"load_friction_linear": 3e-3},
        {"load_friction_linear": 3e-3, "load_friction_quadratic": 4e-6},
    ],
    "stribeck_friction": [{"stribeck_ratio": 1.4, "stribeck_velocity": 0.05}],
    "asymmetric_friction": [{"friction_offset": -2.0}, {"friction_offset": -2.0, "viscous_asymmetry": 8.0}],
    "quadratic_drag": [{"quadratic_drag": 5.5}],
    "temperature_friction": [
        {"viscous_slope": -1.5, "reference_temperature": 30.0},
        {"viscous_slope": -1.5, "coulomb_slope": 0.1, "reference_temperature": 30.0},
    ],
    "presliding": [{"presliding_distance": 2e-4, "presliding_torque": 24.0}],
    "motor_cogging": [{"cogging_order": 6.0, "cogging_amplitude": 2.0, "cogging_phase": 0.7}],
    "torque_constant_error": [{"torque_constant_error": -0.02}],
    "actuation_delay": [{"delay": 1.3e-3}],
    "gauge_ripple": [
        {"cosine_2": 0.5, "sine_2": 0.2, "joint_turn": 0.0},
        {"cosine_2": 0.5, "sine_2": 0.2, "cosine_4": -0.1, "sine_4": 0.3, "joint_turn": -1.0},
    ],
    "gauge_gain": [{"gauge_gain_error": 0.021}],
    "gauge_offset": [{"gauge_offset": -0.4}],
    "joint_sensor_eccentricity": [
        {"cosine_1": 4e-5, "sine_1": 1e-5},
        {"cosine_1": 4e-5, "sine_1": 1e-5, "cosine_2": -1e-5, "sine_2": 2e-6},
    ],
    "payload": [
        {"gravity_cosine": 1.0, "gravity_sine": 11.0},
        {"tool_mass": 2.0, "tool_moment_x": 0.1},
        {"link_moment_y": 1.0, "link_inertia_zz": 0.3},
    ],
    "link_friction": [{"link_coulomb": 1.2}, {"link_viscous": 3.0}, {"link_coulomb": 1.2, "link_viscous": 3.0}],
    "structural_resonance": [{"frequency": 18.0, "damping_ratio": 0.03, "inertia_share": 0.15}],
}
"""Values of a model file for every effect, every form of it."""


def states_of(**fields: Any) -> DriveStates:
    """States that are zero but for the given fields; (n,) by the longest of them, numbers are repeated."""
    numbers = {"period": 1e-3, "gear_ratio": 1.0, "torque_scale": 1.0, "torsional_compliance": 0.0}
    given = {name: np.asarray(value, dtype=float) for name, value in fields.items() if name not in numbers}
    size = max((len(np.atleast_1d(value)) for value in given.values()), default=1)
    apart = ("_regressor", "spring_torque")
    names = [n for n in DriveStates.__dataclass_fields__ if n not in numbers and not n.endswith(apart)]
    arrays = {name: np.zeros(size) for name in names}
    for name, value in given.items():
        arrays[name] = (
            value.reshape(size, -1) if name.endswith("_regressor") else np.broadcast_to(value, (size,)).copy()
        )
    return DriveStates(**{**numbers, **{k: v for k, v in fields.items() if k in numbers}}, **arrays)


def moving(n: int = 4000, seed: int = 3) -> DriveStates:
    """A smooth trajectory with reversals of speed and torque, all signals consistent with a drive of joint 3."""
    period, stiffness = 1e-3, 2.9e5
    t = period * np.arange(n)
    q = 0.5 * np.sin(2.0 * np.pi * 0.4 * t) + 0.08 * np.sin(2.0 * np.pi * 1.7 * t + 1.0)
    v = np.gradient(q, period)
    a = np.gradient(v, period)
    torque = 120.0 * np.sin(q) + 40.0 * a
    rng = np.random.default_rng(seed)
    phi = q + torque / stiffness
    rate = np.gradient(phi, period)
    regressor = np.stack([np.cos(k * q) + 0.1 * k * a for k in range(10)], axis=1)
    return DriveStates(
        period=period, gear_ratio=120.0, torque_scale=float(np.quantile(np.abs(torque), 0.98)), time=t,
        motor_position=phi, motor_velocity=rate, motor_acceleration=np.gradient(rate, period),
        motor_direction=np.sign(rate), joint_position=q, joint_velocity=v, joint_acceleration=a, gauge_torque=torque,
        joint_torque=torque, joint_torque_rate=np.gradient(torque, period),
        motor_torque=torque + 28.0 * a + 24.0 * np.sign(rate) + rng.normal(size=n),
        temperature=25.0 + 10.0 * t / t[-1], link_inertia_torque=40.0 * a, link_bias_torque=120.0 * np.sin(q),
        link_regressor=regressor, tool_regressor=regressor[:, ::-1].copy(), torsional_compliance=1.0 / stiffness,
    )  # fmt: skip
