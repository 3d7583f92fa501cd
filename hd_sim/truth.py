"""Hidden truths: switch effects on by name and strength, strip a plant to the nominal model, keep the truth sealed.

What is hidden goes into a sealed file and nowhere else, never into a bag. The seal guards against accidents: nobody
reads the answer by opening the file or searching the folder, and a changed file is noticed. It is no cryptography.
"""

from __future__ import annotations

import base64
import difflib
import hashlib
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.errors import ConfigError
from hd_control.core.files import whole_file
from hd_sim.hidden_effects import EFFECTS, OUTSIDE, Drive, sizes
from hd_sim.plant_config import SETTINGS, PlantConfig
from hd_sim.sensors import noise_key

# ---- The right values of a hidden effect's parameters, by the names of the model vocabulary --------
#
# Where the world has another law on purpose (soft wind-up, bristles, Maxwell slip), only those parameters are given
# that mean the same in both.


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


# ---- Hiding and sealing ----------------------------------------------------------------------------


SCHEMA = "hd.seal/1"
MAX_BYTES = 10_000_000

_KEPT_BY_NOMINAL = (
    "gear_ratio rotor_inertia torque_limit rated_torque stiffness_linear torsional_damping coulomb_torque "
    "viscous_positive "
    "encoder_counts resolver_bits gauge_noise gauge_rated_strain gauge_modulation_strain ambient_temperature "
    "thermal_time_constant copper_heating friction_heating reference_temperature brake_torque brake_closing_time "
    "presliding_distance friction_slip_share friction_slip_distance"
).split()


@dataclass(frozen=True)
class HiddenEffect:
    """One hidden effect: joint (index from 0, or name), effect name, strength (1: mid-range for that drive)."""

    joint: int | str
    name: str
    strength: float = 1.0


def nominal(config: PlantConfig) -> PlantConfig:
    """The plant without anything beyond the model that every drive has.

    Kept: rotor inertia, linear stiffness and damping, Coulomb and viscous friction (same in both directions), link
    dynamics, quantisation, gauge noise, temperature (without influence), limits and brake.
    """
    drives = {}
    for name, values in config.drives.items():
        kept = values.copy() if name in _KEPT_BY_NOMINAL else np.full_like(values, SETTINGS[name].neutral)
        drives[name] = kept
    drives["viscous_negative"] = config.drives["viscous_positive"].copy()
    return replace(config, drives=drives)


def apply_hidden(config: PlantConfig, effects: Sequence[HiddenEffect], seed: int) -> PlantConfig:
    """The plant with hidden effects added to what it has. Strength 0 changes nothing.

    `seed` draws signs, phases and shapes, for every joint and effect from its own stream. Raises ConfigError.
    """
    drives = {name: values.copy() for name, values in config.drives.items()}
    for effect in effects:
        joint = _joint(config, effect)
        if effect.name not in EFFECTS:
            near = difflib.get_close_matches(effect.name, EFFECTS, 1)
            raise ConfigError(f"unknown effect {effect.name!r}" + (f", did you mean {near[0]!r}?" if near else ""))
        if not (np.isfinite(effect.strength) and effect.strength >= 0.0):
            raise ConfigError(f"{effect.name}: strength {effect.strength} is not a number >= 0")
        if effect.strength > 0.0:
            inertia = _effective_inertia(config, joint) if effect.name == "structural_resonance" else 0.0
            center, start = config.robot.center_of_mass[joint], float(config.start_position[joint])
            drive = Drive(drives, joint, center, start, inertia)
            rng = np.random.default_rng(noise_key(seed, f"{effect.name}/{config.robot.joint_names[joint]}"))
            EFFECTS[effect.name](drive, sizes()[effect.name], effect.strength, rng)
    return replace(config, drives=drives)


def truth_of(config: PlantConfig, effects: Sequence[HiddenEffect], seed: int) -> dict[str, Any]:
    """What is hidden, for the sealed file: effects with the settings that they changed, before and after."""
    names = config.robot.joint_names
    found = []
    for effect in effects:
        joint = _joint(config, effect)
        alone = apply_hidden(config, [effect], seed)
        changed = {
            name: {"before": config.drives[name][joint].tolist(), "after": values[joint].tolist()}
            for name, values in alone.drives.items()
            if not np.array_equal(values[joint], config.drives[name][joint])
        }
        outside = effect.name in OUTSIDE
        found.append({**asdict(effect), "joint": names[joint], "outside_vocabulary": outside, "settings": changed})
    return {"robot": config.robot.name, "seed": seed, "effects": found}


def write_seal(path: str | Path, truth: Mapping[str, Any]) -> None:
    """Writes a sealed file, readable by its owner only. Raises ConfigError if the file exists."""
    text = json.dumps(truth, sort_keys=True, allow_nan=False).encode()
    content = base64.b64encode(zlib.compress(text, 9)).decode()
    sealed = {
        "schema": SCHEMA,
        "note": "sealed truth of a simulation; open it only after the diagnosis is written",
        "sha256": hashlib.sha256(text).hexdigest(),
        "content": content,
    }
    if os.path.lexists(path):
        raise ConfigError(f"{path}: exists already; a seal is never replaced, choose another name")
    with whole_file(path, ConfigError) as place:
        handle = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(sealed, file, indent=1)
            file.write("\n")


def open_seal(path: str | Path) -> dict[str, Any]:
    """The truth of a sealed file. Raises ConfigError if it is missing, foreign, damaged or changed."""
    try:
        data = Path(path).read_bytes()
        if len(data) > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES} bytes")
        sealed = json.loads(data)
        if sealed["schema"] != SCHEMA:
            raise ConfigError(f"{path}: schema {sealed['schema']!r}, expected {SCHEMA}")
        unpack = zlib.decompressobj()
        text = unpack.decompress(base64.b64decode(sealed["content"], validate=True), MAX_BYTES)
        if not unpack.eof or hashlib.sha256(text).hexdigest() != sealed["sha256"]:
            raise ConfigError(f"{path}: the seal is broken (content and checksum differ)")
        truth: dict[str, Any] = json.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the seal ({error.strerror})") from None
    except (ValueError, KeyError, TypeError, zlib.error):
        raise ConfigError(f"{path}: not a sealed file, or damaged") from None
    return truth


def _joint(config: PlantConfig, effect: HiddenEffect) -> int:
    if isinstance(effect.joint, str):
        return config.robot.indices([effect.joint])[0]
    if not 0 <= effect.joint < config.joints:
        raise ConfigError(f"{effect.name}: joint {effect.joint} is outside [0, {config.joints - 1}]")
    return effect.joint


def _effective_inertia(config: PlantConfig, joint: int) -> float:
    """Smallest inertia that the joint feels with all others free, kg m^2, over 200 fixed random poses."""
    from hd_sim.plant import make_kernel

    kernel, zeros = make_kernel(config), np.zeros(config.joints)
    poses: NDArray[np.float64] = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, config.joints))
    inertias = [kernel.accelerate(pose, zeros, zeros, zeros)[1] for pose in poses]
    return float(min(1.0 / np.linalg.inv(inertia)[joint, joint] for inertia in inertias))
