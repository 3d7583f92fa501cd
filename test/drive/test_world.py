"""Model against world: both describe the same physics, written twice by different rules.

A joint of the world runs open loop; the free run of the model starts from its true states and is driven by the same
torque. With the effect in the model the error must fall to the size of the step (1 ms, one friction sign per step);
without it, it must be far above. Soft wind-up, backlash smoothing and bristle damping of the world are its own laws.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from oracles.plant_runs import flywheel

from hd_control.drive.effect import DriveStates
from hd_control.drive.model import JointModel, ModelValue
from hd_control.drive.predict import FreeRun, free_run
from hd_sim.plant import Plant

INERTIA, COULOMB, VISCOUS, STIFFNESS = 1.0, 4.0, 25.0, 26000.0

# effect: settings of the world, the same in the model, share of the error without it that may be left in the motor
# position (measured on this run, about doubled)
CASES: dict[str, tuple[dict[str, Any], dict[str, dict[str, float]], float]] = {
    "kinematic_error": (
        {"kinematic_cosine": [[0, 2e-4, 0, 0]], "kinematic_sine": [[0, 0, 0, 5e-5]]},
        {"kinematic_error": {"cosine_2": 2e-4, "sine_2": 0.0, "cosine_4": 0.0, "sine_4": 5e-5}},
        0.14,
    ),
    "torsional_hysteresis": (
        {"hysteresis_stiffness": 6000.0, "hysteresis_rate": 4000.0},
        {"torsional_hysteresis": {"hysteresis_stiffness": 6000.0, "hysteresis_rate": 4000.0}},
        0.1,
    ),
    "hardening": ({"stiffness_cubic": 4e11}, {"nonlinear_stiffness": {"stiffness_cubic": 4e11}}, 0.17),
    "stribeck_friction": (
        {"stribeck_ratio": 1.8, "stribeck_velocity": 0.1},
        {"stribeck_friction": {"stribeck_ratio": 1.8, "stribeck_velocity": 0.1}},
        0.013,
    ),
    "load_dependent_friction": (
        {"load_friction_linear": 0.05},
        {"load_dependent_friction": {"load_friction_linear": 0.05}},
        0.003,
    ),
    "asymmetric_friction": (
        {"friction_offset": 1.0, "viscous_negative": 30.0},
        {
            "asymmetric_friction": {"friction_offset": 1.0, "viscous_asymmetry": -2.5},
            "viscous_friction": {"viscous": 27.5},
        },
        0.003,
    ),
    "quadratic_drag": ({"quadratic_drag": 20.0}, {"quadratic_drag": {"quadratic_drag": 20.0}}, 0.002),
    "motor_cogging": (
        {"cogging_order": [[6, 0]], "cogging_amplitude": [[1.5, 0]], "cogging_phase": [[0.7, 0]]},
        {"motor_cogging": {"cogging_order": 6.0, "cogging_amplitude": 1.5, "cogging_phase": 0.7}},
        0.008,
    ),
    "torque_constant_error": (
        {"torque_constant_error": 0.1},
        {"torque_constant_error": {"torque_constant_error": 0.1}},
        0.001,
    ),
    "actuation_delay": ({"command_delay": 3e-3}, {"actuation_delay": {"delay": 3e-3}}, 0.02),
    "soft_windup": (
        {"windup_depth": 1e-4, "windup_width": 4e-4},
        {"nonlinear_stiffness": {"windup_depth": 1e-4, "windup_width": 4e-4}},
        0.38,
    ),
    "backlash": ({"backlash_half_gap": 1e-4}, {"backlash": {"half_gap": 1e-4, "crossing_torque": 0.1}}, 0.9),
    "presliding": (
        {"friction_law": "bristle", "presliding_distance": 5e-4},
        {"presliding": {"presliding_distance": 5e-4, "presliding_torque": COULOMB}},
        0.45,
    ),
    "link_friction": (
        {"link_coulomb": 1.0, "link_viscous": 3.0, "link_presliding_distance": 1e-5, "link_bristle_damping": 0.0},
        {"link_friction": {"link_coulomb": 1.0, "link_viscous": 3.0}},
        0.005,
    ),
    "structural_resonance": (
        {"resonance_inertia": 0.3 * INERTIA, "resonance_frequency": 15.0, "resonance_damping": 0.03},
        {"structural_resonance": {"frequency": 15.0, "damping_ratio": 0.03, "inertia_share": 0.3}},
        0.06,
    ),
}
SENSORS: dict[str, tuple[dict[str, Any], dict[str, dict[str, float]]]] = {
    "gauge_gain": ({"gauge_gain_error": 0.05}, {"gauge_gain": {"gauge_gain_error": 0.05}}),
    "gauge_offset": ({"gauge_offset": 0.8}, {"gauge_offset": {"gauge_offset": 0.8}}),
    "gauge_ripple": (
        {"extra_ripple_cosine": 0.4, "extra_ripple_sine": -0.2},
        {"gauge_ripple": {"cosine_2": 0.4, "sine_2": -0.2}},
    ),
    "gauge_ripple_turning": (
        {"extra_ripple_cosine": 0.4, "extra_ripple_sine": -0.2, "gauge_joint_turn": -1.0},
        {"gauge_ripple": {"cosine_2": 0.4, "sine_2": -0.2, "joint_turn": -1.0}},
    ),
}


def world_states(settings: Mapping[str, Any], seconds: float = 12.0) -> DriveStates:
    """True states of one joint under an open-loop sum of sines, sensors without noise."""
    base = {"coulomb_torque": COULOMB, "viscous_positive": VISCOUS, "viscous_negative": VISCOUS}
    config = flywheel(INERTIA, **{**base, **settings})
    t = np.arange(round(seconds * 1000)) * 1e-3
    lines = ((14.0, 0.4, 0.0), (9.0, 1.3, 1.0), (6.0, 2.7, 0.0), (4.0, 7.0, 0.0))
    command = sum(a * np.sin(2.0 * np.pi * f * t + phase) for a, f, phase in lines)
    record = Plant(config).step_many(np.asarray(command)[:, None], samples=True, truth=True)
    truth = {name: column[:, 0] for name, column in record.truth.items()}
    seen = {name: column[:, 0] for name, column in record.samples.items()}
    acceleration = np.gradient(truth["joint_velocity"], 1e-3)
    return DriveStates(
        period=1e-3, gear_ratio=float(config.drives["gear_ratio"][0]),
        torque_scale=float(np.quantile(np.abs(truth["joint_torque"]), 0.98)), time=t,
        motor_position=truth["motor_position"], motor_velocity=truth["motor_velocity"],
        motor_acceleration=np.gradient(truth["motor_velocity"], 1e-3), motor_direction=np.sign(truth["motor_velocity"]),
        joint_position=seen["joint_position"], joint_velocity=truth["joint_velocity"], joint_acceleration=acceleration,
        gauge_torque=seen["gauge_torque"], joint_torque=seen["gauge_torque"],
        joint_torque_rate=np.gradient(truth["joint_torque"], 1e-3), motor_torque=seen["motor_torque_applied"],
        temperature=seen["motor_temperature"], link_inertia_torque=INERTIA * acceleration,
        link_bias_torque=np.zeros(t.size),
    )  # fmt: skip


def model(effects: Mapping[str, Mapping[str, float]]) -> JointModel:
    """The joint of `world_states` with effects added to what every model has."""
    base: dict[str, dict[str, float]] = {
        "rotor_inertia": {"rotor_inertia": 1.0},
        "torsional_stiffness": {"torsional_stiffness": STIFFNESS, "damping_time": 1e-3},
        "coulomb_friction": {"coulomb_torque": COULOMB},
        "viscous_friction": {"viscous": VISCOUS},
        "link_dynamics": {"inertia": INERTIA},
    }
    values = {**base, **effects}
    return JointModel(160.0, 40.0, {e: {p: ModelValue(x) for p, x in v.items()} for e, v in values.items()})


@lru_cache(maxsize=1)
def plain() -> tuple[DriveStates, FreeRun]:
    """The world and the model without anything hidden."""
    states = world_states({})
    return states, free_run(model({}), states, 0.5, 0.25)


def test_without_anything_hidden_the_free_run_follows_the_world() -> None:
    _, run = plain()
    assert run.clipped_share == 0.0 and run.windows > 30
    # 0.5 s of motion through reversals: 4e-6 rad measured, the step's own error
    assert run.rms_motor_position[-1] < 1e-5 < 1e-3 * run.hold_motor_position[-1]
    assert run.rms_joint_torque[1:].max() < 0.02 * run.hold_joint_torque[-1]


@pytest.mark.parametrize("name", CASES)
def test_the_effect_closes_the_gap(name: str) -> None:
    settings, effects, left = CASES[name]
    states = world_states(settings)
    without, with_it = (free_run(model(e), states, 0.5, 0.25) for e in ({}, effects))
    # An effect that hardly moves the joint shows in the torque; all others in the motion.
    error = with_it.rms_motor_position[-1] / without.rms_motor_position[-1]
    assert without.rms_motor_position[-1] > 3e-5, "the case must show the effect"
    assert error < left, f"{error:.3f} of the error is left"
    torque = with_it.rms_joint_torque[-100:].mean() / without.rms_joint_torque[-100:].mean()
    assert torque < max(2.0 * left, 0.2), f"{torque:.3f} of the torque error is left"


@pytest.mark.parametrize("name", SENSORS)
def test_what_the_gauge_adds_is_taken_off(name: str) -> None:
    settings, effects = SENSORS[name]
    states = world_states(settings)
    without, with_it = (free_run(model(e), states, 0.5, 0.25) for e in ({}, effects))
    clean = plain()[1].rms_joint_torque[-100:].mean()
    assert without.rms_joint_torque[-100:].mean() > 5.0 * clean
    assert with_it.rms_joint_torque[-100:].mean() < 1.1 * clean


def test_the_eccentric_joint_sensor_is_understood() -> None:
    states = world_states({"eccentricity_cosine": [[2e-4, 0]], "eccentricity_sine": [[0, 1e-4]]})
    values = {"joint_sensor_eccentricity": {"cosine_1": 2e-4, "sine_1": 0.0, "cosine_2": 0.0, "sine_2": 1e-4}}
    without, with_it = (free_run(model(e), states, 0.5, 0.25) for e in ({}, values))
    assert with_it.rms_joint_position[-1] < 0.4 * without.rms_joint_position[-1]
