"""Configuration of the world: a robot description, the drives of its joints, tick and scheme, from strict YAML.

A plant file names the robot, the tick, and a drive type for every joint, and may replace settings of all of them (key
`settings`); a drives file holds the types. Nothing is assumed silently: required settings are in the file, everything
else is neutral, unknown keys are refused.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Parameter, Shape
from hd_control.core.resources import find_config
from hd_control.core.robot import Robot
from hd_control.core.strict_yaml import expect_keys, load_yaml
from hd_sim import _plant
from hd_sim.sensors import misalignment_ripple

# ---- Settings of a drive: unit, bounds, neutral value ----------------------------------------------
#
# The numbers that the kernel reads are declared once, in `hd_sim/cpp/fields.hpp`. This module adds bounds, says which
# of them a file must give, and adds the few settings that a person writes in another form (bits, degrees, strain,
# names). A setting that a file may leave out is neutral: the effect is absent.


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


# ---- The plant -------------------------------------------------------------------------------------


SCHEMES = ("reversals_resolved", "first_order")
TOP = ("robot", "period", "substeps_per_ms", "extra_delay_samples", "start_position", "drives", "joints")


@dataclass(frozen=True)
class PlantConfig:
    """The world of one arm. `drives` maps a setting to its values, (n,) or (n, numbers); SI units, output side.

    period in s; extra_delay_samples: ticks of command delay that the drive declares, beyond the loop's own.
    """

    robot: Robot
    drives: Mapping[str, FloatArray]
    start_position: FloatArray
    period: float = 1e-3
    substeps_per_ms: int = 5
    extra_delay_samples: int = 0
    scheme: str = "reversals_resolved"

    def __post_init__(self) -> None:
        substeps = self.period * 1e3 * self.substeps_per_ms
        if (
            not self.period > 0.0
            or self.substeps_per_ms < 1
            or abs(substeps - round(substeps)) > 1e-9
            or substeps < 0.5
        ):
            raise ConfigError(
                f"period {self.period:g} s with substeps_per_ms {self.substeps_per_ms}: a tick must hold a whole "
                "number of substeps; raise substeps_per_ms"
            )
        if self.scheme not in SCHEMES:
            raise ConfigError(f"scheme: {self.scheme!r} is not one of {', '.join(SCHEMES)}")
        if not 0 <= self.extra_delay_samples <= 16:
            raise ConfigError(f"extra_delay_samples: {self.extra_delay_samples} is outside [0, 16]")
        pairs = [("hysteresis_stiffness", "hysteresis_rate"), ("coulomb_torque", "presliding_distance")]
        for needs, other in pairs:
            active = self.drives["friction_law"] > 0 if needs == "coulomb_torque" else self.drives[needs] > 0
            if np.any(active & (self.drives[other] <= 0)) or np.any(active & (self.drives[needs] <= 0)):
                raise ConfigError(f"{other}: must be positive on joints where {needs} is in use")

    @classmethod
    def from_file(cls, name_or_path: str) -> PlantConfig:
        """Reads a user's plant file, or a shipped one by name (`arm_a`). Raises ConfigError with file and key."""
        name = name_or_path if name_or_path.endswith((".yaml", ".yml")) else f"{name_or_path}.yaml"
        path = find_config(name, "plant")
        table = expect_keys(load_yaml(path), str(path), TOP, ["scheme", "settings"])
        robot = Robot.from_file(_text(table, "robot", path))
        joints = table["joints"]
        if not isinstance(joints, list) or len(joints) != robot.joints:
            raise ConfigError(
                f"{path}: joints: expected {robot.joints} drive types, one for each joint of {robot.name}"
            )
        beside = path.parent / _text(table, "drives", path)
        types = _read_drives(beside if beside.exists() else find_config(_text(table, "drives", path), "plant"))
        for joint in joints:
            if joint not in types:
                near = difflib.get_close_matches(str(joint), list(types), 1)
                hint = f", did you mean {near[0]!r}?" if near else f"; there is {', '.join(types)}"
                raise ConfigError(f"{path}: joints: unknown drive {joint!r}{hint}")
        own = _settings(table.get("settings") or {}, f"{path}: settings")
        types = {name: {**values, **own} for name, values in types.items()}
        return cls(
            robot=robot,
            drives={key: np.array([types[joint][key] for joint in joints], dtype=float) for key in SETTINGS},
            start_position=_numbers(table, "start_position", robot.joints, path),
            period=_number(table, "period", path),
            substeps_per_ms=_whole(table, "substeps_per_ms", path),
            extra_delay_samples=_whole(table, "extra_delay_samples", path),
            scheme=str(table.get("scheme", SCHEMES[0])),
        )

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.robot.joints

    @property
    def substeps(self) -> int:
        """Substeps per tick."""
        return round(self.period * 1e3 * self.substeps_per_ms)

    def with_settings(self, **settings: ArrayLike | str) -> PlantConfig:
        """A copy with drive settings replaced: one value for all joints, or one per joint. Raises ConfigError."""
        drives = dict(self.drives)
        for name, value in settings.items():
            if name not in drives:
                near = difflib.get_close_matches(name, list(drives), 1)
                raise ConfigError(f"{name}: unknown setting" + (f", did you mean {near[0]!r}?" if near else ""))
            number: ArrayLike = FRICTION_LAWS.index(value) if isinstance(value, str) else value
            drives[name] = np.array(np.broadcast_to(np.asarray(number, dtype=float), drives[name].shape))
        return replace(self, drives=drives)

    def parameters(self) -> Block:
        """The parameter block of the kernel: links with payload, drives, sensors in the kernel's own form."""
        block = layout_of("PlantParameters", _plant.BLOCKS["PlantParameters"], self.joints).zeros()
        for name in block.layout.slices:
            if name in self.drives:
                block.view(name)[...] = self.drives[name]
        _write_links(block, self)
        _write_derived(block, self.drives)
        return block


def _write_links(block: Block, config: PlantConfig) -> None:
    """Rigid links, with a payload added as a point mass."""
    robot, extra, at = config.robot, config.drives["payload_mass"], config.drives["payload_center"]
    mass = robot.mass + extra
    center = (robot.mass[:, None] * robot.center_of_mass + extra[:, None] * at) / mass[:, None]
    apart = at - robot.center_of_mass
    reduced = robot.mass * extra / mass
    square = np.einsum("ji,ji->j", apart, apart)
    added = reduced[:, None, None] * (square[:, None, None] * np.eye(3) - np.einsum("ji,jk->jik", apart, apart))
    block.link_rotation = robot.rotation.reshape(-1, 9)
    block.link_origin = robot.origin
    block.link_mass = mass
    block.link_center = center
    block.link_inertia = (robot.inertia + added).reshape(-1, 9)


def _write_derived(block: Block, drives: Mapping[str, FloatArray]) -> None:
    """Settings that a person writes in another form: Zhu's bristle, resolver bits, Hashimoto's bridge (13)."""
    travel, link_travel = drives["presliding_distance"], drives["link_presliding_distance"]
    stiffness = np.divide(drives["coulomb_torque"], travel, out=np.zeros_like(travel), where=travel > 0)
    block.bristle_stiffness = stiffness
    block.bristle_damping = 0.3 * np.sqrt(stiffness * drives["rotor_inertia"])
    block.link_bristle_stiffness = np.divide(
        drives["link_coulomb"], link_travel, out=np.zeros_like(travel), where=link_travel > 0
    )
    block.resolver_counts = np.where(drives["resolver_bits"] > 0, 2.0 ** drives["resolver_bits"], 0.0)
    for j, angle in enumerate(np.deg2rad(drives["gauge_misalignment_deg"])):
        ripple = misalignment_ripple(angle, drives["gauge_modulation_strain"][j], drives["gauge_rated_strain"][j])
        amplitude = ripple.amplitude * drives["rated_torque"][j]
        sine = amplitude * np.cos(ripple.phase) + drives["extra_ripple_sine"][j]
        cosine = amplitude * np.sin(ripple.phase) + drives["extra_ripple_cosine"][j]
        block.gauge_ripple_amplitude[j] = np.hypot(sine, cosine)
        block.gauge_ripple_phase[j] = np.arctan2(cosine, sine)
    block.gauge_fourth_amplitude = drives["gauge_fourth_strain"] / drives["gauge_rated_strain"] * drives["rated_torque"]
    block.friction_law = drives["friction_law"]


def _read_drives(path: Path) -> dict[str, dict[str, Any]]:
    """Drive types by name; the section `common` holds for all of them, a type's own value wins."""
    table = load_yaml(path)
    if not isinstance(table, Mapping) or len(table) < 1:
        raise ConfigError(f"{path}: expected drive types with their settings")
    common = table.get("common") or {}
    types: dict[str, dict[str, Any]] = {}
    for name, own in table.items():
        if name == "common":
            continue
        where = f"{path}: {name}"
        given = {
            **expect_keys(common, f"{path}: common", (), list(SETTINGS)),
            **expect_keys(own, where, (), list(SETTINGS)),
        }
        missing = [key for key in REQUIRED if key not in given]
        problems = [f"{key}: missing ({SETTINGS[key].parameter.meaning})" for key in missing]
        problems += [text for key, value in given.items() for text in SETTINGS[key].problems(value)]
        if problems:
            raise ConfigError(f"{where}: " + "; ".join(problems))
        types[str(name)] = {key: _value(key, given) for key in SETTINGS}
    return types


def _settings(table: Any, where: str) -> dict[str, Any]:
    """Drive settings of a plant file, for all its joints; they win over those of the drive types."""
    given = expect_keys(table, where, (), list(SETTINGS))
    if problems := [text for key, value in given.items() for text in SETTINGS[key].problems(value)]:
        raise ConfigError(f"{where}: " + "; ".join(problems))
    return {key: _value(key, given) for key in given}


def _value(key: str, given: Mapping[str, Any]) -> float | list[float]:
    setting = SETTINGS[key]
    if key not in given:
        return setting.neutral if setting.numbers == 1 else [setting.neutral] * setting.numbers
    if key == "friction_law":
        return float(FRICTION_LAWS.index(given[key]))
    value = given[key]
    return [float(number) for number in value] if setting.numbers > 1 else float(value)


def _text(table: Mapping[str, Any], key: str, path: Path) -> str:
    if not isinstance(table[key], str):
        raise ConfigError(f"{path}: {key}: {table[key]!r} is not text")
    return str(table[key])


def _number(table: Mapping[str, Any], key: str, path: Path) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{path}: {key}: {value!r} is not a number")
    return float(value)


def _whole(table: Mapping[str, Any], key: str, path: Path) -> int:
    value = _number(table, key, path)
    if value != int(value):
        raise ConfigError(f"{path}: {key}: {value:g} is not a whole number")
    return int(value)


def _numbers(table: Mapping[str, Any], key: str, count: int, path: Path) -> FloatArray:
    value = table[key]
    if not isinstance(value, list) or len(value) != count:
        raise ConfigError(f"{path}: {key}: expected {count} numbers, one for each joint")
    return np.array([_number({key: item}, key, path) for item in value])
