"""The right values of a hidden effect's parameters, by the names of the model vocabulary, where both laws are the same.

Where the world has another law on purpose (soft wind-up, bristles, Maxwell slip), only those parameters are given that
mean the same in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_sim.plant_config import PlantConfig

PARAMETERS: Mapping[str, Mapping[str, tuple[str, int]]] = {
    "kinematic_error": {
        "cosine_2": ("kinematic_cosine", 1),
        "sine_2": ("kinematic_sine", 1),
        "cosine_4": ("kinematic_cosine", 3),
        "sine_4": ("kinematic_sine", 3),
    },
    "torsional_hysteresis": {
        "hysteresis_stiffness": ("hysteresis_stiffness", 0),
        "hysteresis_rate": ("hysteresis_rate", 0),
    },
    "nonlinear_stiffness": {
        "stiffness_cubic": ("stiffness_cubic", 0),
        "windup_depth": ("windup_depth", 0),
        "windup_width": ("windup_width", 0),
    },
    "backlash": {"half_gap": ("backlash_half_gap", 0)},
    "load_dependent_friction": {"load_friction_linear": ("load_friction_linear", 0)},
    "stribeck_friction": {
        "stribeck_ratio": ("stribeck_ratio", 0),
        "stribeck_velocity": ("stribeck_velocity", 0),
    },
    "asymmetric_friction": {"friction_offset": ("friction_offset", 0), "viscous_negative": ("viscous_negative", 0)},
    "quadratic_drag": {"quadratic_drag": ("quadratic_drag", 0)},
    "temperature_friction": {
        "viscous_temperature_slope": ("viscous_temperature_slope", 0),
        "coulomb_temperature_slope": ("coulomb_temperature_slope", 0),
    },
    "presliding": {"presliding_distance": ("presliding_distance", 0)},
    "motor_cogging": {
        "cogging_order": ("cogging_order", 0),
        "cogging_amplitude": ("cogging_amplitude", 0),
        "cogging_phase": ("cogging_phase", 0),
    },
    "torque_constant_error": {"torque_constant_error": ("torque_constant_error", 0)},
    "actuation_delay": {"delay": ("command_delay", 0)},
    "gauge_ripple": {"cosine_2": ("extra_ripple_cosine", 0), "sine_2": ("extra_ripple_sine", 0)},
    "gauge_gain": {"gauge_gain_error": ("gauge_gain_error", 0)},
    "gauge_offset": {"gauge_offset": ("gauge_offset", 0)},
    "joint_sensor_eccentricity": {
        "cosine_1": ("eccentricity_cosine", 0),
        "sine_1": ("eccentricity_sine", 0),
        "cosine_2": ("eccentricity_cosine", 1),
        "sine_2": ("eccentricity_sine", 1),
    },
    "payload": {"mass": ("payload_mass", 0), "center_x": ("payload_center", 0), "center_y": ("payload_center", 1)},
    "link_friction": {"link_coulomb": ("link_coulomb", 0), "link_viscous": ("link_viscous", 0)},
    "structural_resonance": {
        "frequency": ("resonance_frequency", 0),
        "damping_ratio": ("resonance_damping", 0),
        "inertia": ("resonance_inertia", 0),
    },
}
"""Effect -> parameter -> (setting of the world, which of its numbers)."""


def true_parameters(name: str, before: PlantConfig, world: PlantConfig, joint: int = 0) -> dict[str, float]:
    """Values of an effect's parameters in the world; those that the effect did not change are left out."""
    found: dict[str, float] = {}
    for parameter, (setting, index) in PARAMETERS[name].items():
        old, new = (_number(config.drives[setting][joint], index) for config in (before, world))
        if new != old:
            found[parameter] = new
    return found


def _number(value: Any, index: int) -> float:
    return float(value[index]) if getattr(value, "ndim", 0) else float(value)
