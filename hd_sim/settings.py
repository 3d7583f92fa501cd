"""What a drive of the world can be told: every setting with unit, bounds and its neutral value.

The numbers that the kernel reads are declared once, in `hd_sim/cpp/fields.hpp`. This module adds bounds, says which
of them a file must give, and adds the few settings that a person writes in another form (bits, degrees, strain, names).
A setting that a file may leave out is neutral: the effect is absent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hd_control.core.parameters import Parameter, ParameterSet, Shape
from hd_sim import _plant

FRICTION_LAWS = ("coulomb", "bristle", "maxwell_slip")

REQUIRED = (
    "gear_ratio rotor_inertia torque_limit rated_torque current_time_constant stiffness_linear torsional_damping "
    "coulomb_torque viscous_positive viscous_negative encoder_counts resolver_bits gauge_noise ambient_temperature "
    "thermal_time_constant copper_heating friction_heating reference_temperature brake_torque brake_closing_time"
).split()

_DERIVED = {
    "link_rotation", "link_origin", "link_mass", "link_center", "link_inertia", "bristle_stiffness", "bristle_damping",
    "link_bristle_stiffness", "resolver_counts", "gauge_ripple_amplitude", "gauge_ripple_phase",
    "gauge_fourth_amplitude",
    "friction_law",
}  # fmt: skip

_POSITIVE = {
    "gear_ratio", "rotor_inertia", "torque_limit", "rated_torque", "stiffness_linear", "gauge_rated_strain",
}  # fmt: skip

_SIGNED = {
    "torque_constant_error", "cogging_amplitude", "cogging_phase", "kinematic_cosine", "kinematic_sine", "windup_depth",
    "kinematic_load_slope", "kinematic_angle_modulation", "tooth_defect_height", "tooth_defect_position",
    "friction_offset", "coulomb_temperature_slope", "viscous_temperature_slope", "friction_angle_phase",
    "friction_step_ratio", "cable_torque", "cable_phase", "pulse_torque", "eccentricity_cosine", "eccentricity_sine",
    "gauge_gain_error", "gauge_offset", "gauge_joint_turn", "gauge_mounting_angle", "gauge_gain_temperature",
    "gauge_offset_temperature", "gauge_offset_drift", "ambient_temperature", "reference_temperature",
    "gauge_misalignment_deg", "payload_center", "stiffness_cubic", "stiffness_quintic", "extra_ripple_cosine",
    "extra_ripple_sine",
}  # fmt: skip

_NEUTRAL = {"stribeck_ratio": 1.0, "gauge_rated_strain": 2e-4, "friction_law": 0.0}

_LIMITS = {
    "stribeck_ratio": (1.0, 10.0),
    "friction_angle_modulation": (0.0, 0.95),
    "torque_constant_saturation": (0.0, 0.9),
    "gauge_joint_turn": (-1.0, 1.0),
    "command_delay": (0.0, 0.01),
    "resolver_bits": (0.0, 40.0),
    "torque_constant_error": (-0.9, 10.0),
    "gauge_gain_error": (-0.9, 10.0),
}

_WRITTEN = (
    ("friction_law", 1, "-", "coulomb (set-valued), bristle or maxwell_slip"),
    ("rated_torque", 1, "N m", "rated torque of the gear; the size that hidden effects are scaled with"),
    ("presliding_distance", 1, "rad", "travel over which the bristle law builds up Coulomb friction"),
    ("link_presliding_distance", 1, "rad", "the same for friction on the link"),
    ("resolver_bits", 1, "-", "bits of the joint resolver, 0: exact"),
    ("gauge_misalignment_deg", 1, "deg", "misalignment of the second gauge pair"),
    ("gauge_modulation_strain", 1, "-", "strain modulation by the wave generator, twice per turn"),
    ("gauge_fourth_strain", 1, "-", "its fourth harmonic, which the second pair does not cancel"),
    ("gauge_rated_strain", 1, "-", "torsional strain at rated torque"),
    ("extra_ripple_cosine", 1, "N m", "ripple at twice the gauge angle from any other cause"),
    ("extra_ripple_sine", 1, "N m", "ripple at twice the gauge angle from any other cause"),
    ("payload_mass", 1, "kg", "mass fixed to the link that the robot description does not know"),
    ("payload_center", 3, "m", "where it sits, in the link frame"),
)


@dataclass(frozen=True)
class Setting:
    """One setting of a drive: how many numbers, neutral value, and the parameter that checks it."""

    parameter: Parameter
    numbers: int
    neutral: float

    @property
    def name(self) -> str:
        """Key in the file."""
        return self.parameter.name

    def problems(self, value: Any) -> list[str]:
        """What is wrong with a value from a file, one sentence each."""
        if self.numbers > 1 and isinstance(value, list) and len(value) != self.numbers:
            return [f"{self.name}: {len(value)} values, expected {self.numbers}"]
        return self.parameter.problems(value, 1)


def _setting(name: str, numbers: int, unit: str, meaning: str) -> Setting:
    low, high = _LIMITS.get(name, (-math.inf if name in _SIGNED else 0.0, math.inf))
    shape = Shape.LIST if numbers > 1 else Shape.SCALAR
    law = name == "friction_law"
    parameter = Parameter(
        name, meaning, unit, kind=str if law else float, shape=shape, low=low, high=high,
        open_low=name in _POSITIVE, choices=FRICTION_LAWS if law else (),
    )  # fmt: skip
    return Setting(parameter, numbers, _NEUTRAL.get(name, 0.0))


_KERNEL_FIELDS = [field for field in _plant.BLOCKS["PlantParameters"] if field[0] not in _DERIVED]
SETTINGS: dict[str, Setting] = {field[0]: _setting(*field) for field in [*_KERNEL_FIELDS, *_WRITTEN]}
DRIVE = ParameterSet("a drive of the world", tuple(setting.parameter for setting in SETTINGS.values()))
