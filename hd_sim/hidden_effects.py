"""Hidden effects of the world: what each name changes on one drive.

Sizes at strength 1 come from `config/plant/hidden_effects.yaml`; torques scale with the rated torque of the gear.
Signs, phases and free shapes are drawn from the effect's own random stream. `OUTSIDE` lists effects that no model
vocabulary names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_yaml
from hd_sim.plant_config import FRICTION_LAWS


@dataclass
class Drive:
    """The settings of one joint, to be changed in place.

    link_center (3,) m, start_position rad, inertia: smallest effective link inertia, kg m^2 (0 where not needed).
    """

    settings: dict[str, FloatArray]
    joint: int
    link_center: FloatArray
    start_position: float
    inertia: float

    def get(self, name: str) -> float:
        """One number."""
        return float(self.settings[name][self.joint])

    def set(self, **values: ArrayLike) -> None:
        """Replaces settings of this joint."""
        for name, value in values.items():
            self.settings[name][self.joint] = value

    def add(self, **values: ArrayLike) -> None:
        """Adds to settings of this joint."""
        for name, value in values.items():
            self.settings[name][self.joint] += np.asarray(value, dtype=float)

    @property
    def rated(self) -> float:
        """Rated torque, N m."""
        return self.get("rated_torque")

    @property
    def rated_torsion(self) -> float:
        """Torsion at rated torque, rad."""
        return self.rated / self.get("stiffness_linear")


Apply = Callable[[Drive, Mapping[str, Any], float, np.random.Generator], None]
EFFECTS: dict[str, Apply] = {}


def _effect(function: Apply) -> Apply:
    EFFECTS[getattr(function, "__name__", "")] = function
    return function


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _wave(amplitude: float, rng: np.random.Generator) -> tuple[float, float]:
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return amplitude * np.cos(phase), amplitude * np.sin(phase)


@_effect
def kinematic_error(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    a2, b2 = _wave(strength * size["amplitude"], rng)
    a4, b4 = _wave(strength * size["amplitude"] * size["fourth_share"], rng)
    drive.add(kinematic_cosine=[0.0, a2, 0.0, a4], kinematic_sine=[0.0, b2, 0.0, b4])


@_effect
def torsional_hysteresis(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    rate = drive.get("hysteresis_rate") or 2.0 * size["sharpness"] / drive.rated_torsion
    drive.set(hysteresis_rate=rate)
    drive.add(hysteresis_stiffness=rate * strength * size["share"] * drive.rated)


@_effect
def nonlinear_stiffness(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    if rng.random() < 0.5:
        hardening = strength * size["cubic_share"] * drive.get("stiffness_linear") / drive.rated_torsion**2
        drive.add(stiffness_cubic=hardening)
    else:  # the soft zone may take at most 0.8 of the stiffness away
        depth = strength * size["windup_depth"]
        drive.set(windup_depth=depth, windup_width=max(size["windup_share"] * drive.rated_torsion, depth / 0.8))


@_effect
def backlash(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(backlash_half_gap=strength * size["half_gap"])


@_effect
def load_dependent_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(load_friction_linear=strength * size["growth"] / drive.rated)


@_effect
def stribeck_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    if drive.get("coulomb_torque") == 0.0:
        raise ConfigError("stribeck_friction: the joint has no Coulomb friction that could rise at low speed")
    drive.add(stribeck_ratio=strength * size["share"] * drive.rated / drive.get("coulomb_torque"))
    drive.set(stribeck_velocity=rng.uniform(size["velocity_low"], size["velocity_high"]))


@_effect
def asymmetric_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(friction_offset=_sign(rng) * strength * size["share"] * drive.rated)
    drive.add(viscous_negative=strength * size["viscous"] * drive.get("viscous_positive"))


@_effect
def quadratic_drag(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(quadratic_drag=strength * size["share"] * drive.rated)


@_effect
def temperature_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(viscous_temperature_slope=strength * size["viscous_slope"])
    drive.add(coulomb_temperature_slope=strength * size["coulomb_slope"])


@_effect
def presliding(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(friction_law=FRICTION_LAWS.index("bristle"), presliding_distance=strength * size["distance"])


@_effect
def motor_cogging(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    line = 0 if drive.settings["cogging_amplitude"][drive.joint, 0] == 0.0 else 1
    for name, value in (
        ("cogging_order", float(rng.choice(size["orders"]))),
        ("cogging_amplitude", strength * size["share"] * drive.rated),
        ("cogging_phase", rng.uniform(0.0, 2.0 * np.pi)),
    ):
        drive.settings[name][drive.joint, line] = value


@_effect
def torque_constant_error(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(torque_constant_error=_sign(rng) * strength * size["error"])


@_effect
def actuation_delay(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(command_delay=strength * size["delay"])


@_effect
def gauge_ripple(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    cosine, sine = _wave(strength * size["share"] * drive.rated, rng)
    drive.add(extra_ripple_cosine=cosine, extra_ripple_sine=sine)


@_effect
def gauge_gain(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(gauge_gain_error=_sign(rng) * strength * size["error"])


@_effect
def gauge_offset(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(gauge_offset=_sign(rng) * strength * size["share"] * drive.rated)


@_effect
def joint_sensor_eccentricity(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    a1, b1 = _wave(strength * size["amplitude"], rng)
    a2, b2 = _wave(strength * size["amplitude"] * size["second_share"], rng)
    drive.add(eccentricity_cosine=[a1, a2], eccentricity_sine=[b1, b2])


@_effect
def payload(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    x, y, z = drive.link_center
    if np.hypot(x, y) < 0.5 * size["lever"]:
        x, y = size["lever"], 0.0
    drive.add(payload_mass=strength * size["share"] * drive.rated / (9.81 * np.hypot(x, y)))
    drive.set(payload_center=[x, y, z])


@_effect
def link_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(link_coulomb=strength * size["coulomb_share"] * drive.rated)
    drive.add(link_viscous=strength * size["viscous_share"] * drive.rated)
    drive.set(link_presliding_distance=size["distance"], link_bristle_damping=strength * size["damping"])


@_effect
def structural_resonance(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    share = min(strength * size["inertia_share"], 0.8)
    drive.set(resonance_inertia=share * drive.inertia, resonance_damping=size["damping_ratio"])
    drive.set(resonance_frequency=rng.uniform(size["frequency_low"], size["frequency_high"]))


VOCABULARY = tuple(EFFECTS)


@_effect
def friction_over_angle(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(friction_angle_modulation=min(strength * size["modulation"], 0.95))
    drive.set(friction_angle_phase=rng.uniform(0.0, 2.0 * np.pi))


@_effect
def cable_torque(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(cable_torque=strength * size["share"] * drive.rated, cable_order=size["order"])
    drive.set(cable_phase=rng.uniform(0.0, 2.0 * np.pi))


@_effect
def friction_step(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(friction_step_ratio=strength * size["ratio"], friction_step_time=size["time"])


@_effect
def tooth_defect(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(tooth_defect_height=strength * size["height"], tooth_defect_width=size["width"])
    drive.set(tooth_defect_position=drive.start_position + rng.uniform(-size["range"], size["range"]))


@_effect
def torque_constant_saturation(
    drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator
) -> None:
    drive.set(torque_constant_saturation=min(strength * size["loss"], 0.9))


@_effect
def gauge_zero_drift(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(gauge_offset_drift=_sign(rng) * strength * size["share_per_second"] * drive.rated)


@_effect
def kinematic_error_with_load(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    a2, b2 = _wave(strength * size["amplitude"], rng)
    drive.add(kinematic_cosine=[0.0, a2, 0.0, 0.0], kinematic_sine=[0.0, b2, 0.0, 0.0])
    drive.set(kinematic_load_slope=size["growth"] / drive.rated, kinematic_angle_modulation=0.0)


@_effect
def contact_pulses(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(pulse_torque=_sign(rng) * strength * size["share"] * drive.rated)
    drive.set(pulse_period=size["period"], pulse_duration=size["duration"])


@_effect
def maxwell_slip_hysteresis(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    yields = strength * size["share"] * drive.rated * np.array(size["yields"])
    drive.set(slip_yield=yields, slip_stiffness=yields / (0.5 * drive.rated_torsion * np.array(size["torsions"])))


@_effect
def maxwell_slip_friction(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    distances = strength * np.array(size["distances"])
    drive.set(friction_law=FRICTION_LAWS.index("maxwell_slip"), presliding_distance=distances[0])
    drive.set(friction_slip_distance=distances, friction_slip_share=size["shares"])


@_effect
def gauge_fourth_harmonic(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.add(gauge_fourth_strain=strength * size["share"] * drive.get("gauge_rated_strain"))


@_effect
def sampling_jitter(drive: Drive, size: Mapping[str, Any], strength: float, rng: np.random.Generator) -> None:
    drive.set(sampling_jitter=strength * size["deviation"])


OUTSIDE = tuple(name for name in EFFECTS if name not in VOCABULARY)


@lru_cache(maxsize=1)
def sizes() -> Mapping[str, Mapping[str, Any]]:
    """Size of every effect at strength 1. Raises ConfigError if the file and the effects disagree."""
    path = config_path("plant/hidden_effects.yaml")
    table: Mapping[str, Mapping[str, Any]] = load_yaml(path)
    if set(table) != set(EFFECTS):
        raise ConfigError(f"{path}: effects differ from the world's: {', '.join(sorted(set(table) ^ set(EFFECTS)))}")
    return table
