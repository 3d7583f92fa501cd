"""What the second world can hide in a joint, each effect in its own law (docs/second_world.md).

`hide(plant, name, strength)` changes values of the joint; strength 1 is a middling size. Effects of the project's
vocabulary carry its names; the others have none there, and a right answer says on which variable they depend.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hd_control.core.errors import ConfigError
from hd_sim.second_world.plant import Plant, Window, stream

Generator = np.random.Generator
Values = dict[str, float]
Make = Callable[[Mapping[str, float], float, Generator], Values]
TURN = 2.0 * np.pi
PLACES = ("tooth_angle", "cable_angle")
"""Joint angles that are drawn about the middle of the motions."""


@dataclass(frozen=True)
class Outside:
    """A right answer for an effect without a name: channels where it shows, variables that it depends on, names that
    say the same."""

    channels: tuple[str, ...]
    variables: tuple[str, ...]
    also: tuple[str, ...] = ()


def _either(rng: Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _log(rng: Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _wave(rng: Generator, stem: str, sizes: Mapping[int, float]) -> Values:
    """Cosine and sine of several orders with random phases."""
    found: Values = {}
    for order, size in sizes.items():
        phase = rng.uniform(0.0, TURN)
        found |= {f"{stem}_cosine_{order}": size * np.cos(phase), f"{stem}_sine_{order}": size * np.sin(phase)}
    return found


# ---- Effects of the vocabulary ---------------------------------------------------------------------


def _kinematic_error(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    size = 5e-5 * s
    waves = _wave(rng, "kinematic", {1: 0.3 * size * rng.random(), 2: size, 4: 0.4 * size * rng.random()})
    return waves | {"kinematic_load": rng.uniform(0.2, 1.0)}


def _torsional_hysteresis(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {
        "hysteresis_torque": 0.02 * s * v["rated_torque"],
        "hysteresis_travel": _log(rng, 5e-5, 2e-4),
        "hysteresis_shape": rng.uniform(0.6, 0.95),
        "hysteresis_exponent": rng.uniform(1.2, 2.0),
    }


def _nonlinear_stiffness(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    """Three slopes as catalogues give them, about the stiffness of the data sheet."""
    middle = v["stiffness_1"]
    first = middle / (1.0 + 0.35 * s)
    corner = rng.uniform(0.1, 0.2) * v["rated_torque"] / first
    return {
        "stiffness_1": first,
        "stiffness_2": first * (1.0 + 0.4 * s),
        "stiffness_3": first * (1.0 + 0.8 * s),
        "corner_1": corner,
        "corner_2": rng.uniform(2.0, 3.0) * corner,
        "corner_width": corner / 6.0,
    }


def _backlash(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"half_gap": 3e-5 * s}


def _load_dependent_friction(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"mesh_load": 3.0 * s / v["rated_torque"]}


def _stribeck_friction(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"stribeck_excess": 0.4 * s, "stribeck_velocity": _log(rng, 0.03, 0.2)}


def _asymmetric_friction(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    viscous = 0.15 * s * rng.random() if rng.random() < 0.5 else 0.0
    return {"coulomb_asymmetry": _either(rng) * 0.08 * s, "viscous_asymmetry": _either(rng) * viscous}


def _quadratic_drag(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"churning": 0.03 * s * v["rated_torque"], "churning_exponent": rng.uniform(1.85, 2.15)}


def _temperature_friction(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"viscous_decay": 0.02 * s}


def _presliding(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    travel = max(6e-4 * s, 2.0 * v["bristle_travel"])
    damping = 0.3 * np.sqrt(v["coulomb"] / travel * v["rotor_inertia"])
    return {"bristle_travel": travel, "breakaway_share": rng.uniform(0.2, 0.5), "bristle_damping": damping}


def _motor_cogging(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {
        "cogging": 0.008 * s * v["rated_torque"],
        "cogging_order": float(rng.choice([4, 6, 8, 10, 12, 18, 24])),
        "cogging_phase": rng.uniform(0.0, TURN),
        "cogging_second": 0.1 * rng.random(),
    }


def _torque_constant_error(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"torque_constant_error": _either(rng) * 0.03 * s}


def _actuation_delay(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"transport_delay": 1.2e-3 * s}


def _gauge_ripple(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    size = 0.006 * s * v["rated_torque"]
    turns = float(rng.random() < 0.5)
    return _wave(rng, "gauge", {2: size, 4: 0.3 * size * rng.random()}) | {"gauge_turns": turns}


def _gauge_gain(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"gauge_gain": _either(rng) * 0.025 * s}


def _gauge_offset(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"gauge_offset": _either(rng) * 0.012 * s * v["rated_torque"]}


def _joint_sensor_eccentricity(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {
        "eccentricity": 8e-5 * s,
        "eccentricity_angle": rng.uniform(0.0, TURN),
        "ellipticity": 4e-5 * s * rng.random(),
        "ellipticity_angle": rng.uniform(0.0, TURN),
    }


def _payload(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    torque, lever = 0.04 * s * v["rated_torque"], rng.uniform(0.15, 0.5)
    angle = v["gravity_angle"] + rng.uniform(-0.8, 0.8)
    return {"payload_gravity": torque, "payload_inertia": torque * lever / 9.81, "payload_angle": angle}


def _link_friction(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    viscous = 0.02 * rng.random() if rng.random() < 0.6 else 0.0
    return {"link_coulomb": 0.01 * s * v["rated_torque"], "link_viscous": viscous * s * v["rated_torque"]}


def _structural_resonance(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {
        "swinging_share": min(0.5, 0.12 * s),
        "swinging_frequency": _log(rng, 3.0, 30.0),
        "swinging_damping": rng.uniform(0.02, 0.08),
    }


# ---- Effects that the vocabulary does not name -----------------------------------------------------


def _viscous_over_angle(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    turns, phase = rng.uniform(1.0, 3.0), rng.uniform(0.0, TURN)
    return {"viscous_over_angle": min(0.9, 0.3 * s), "over_angle_turns": turns, "over_angle_phase": phase}


def _coulomb_over_angle(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    turns, phase = rng.uniform(2.0, 5.0), rng.uniform(0.0, TURN)
    return {"coulomb_over_angle": min(0.9, 0.15 * s), "over_angle_turns": turns, "over_angle_phase": phase}


def _viscous_over_load(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"viscous_over_load": 1.2 * s}


def _friction_step(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"friction_step": float(np.clip(_either(rng) * 0.15 * s, -0.6, 1.0)), "friction_step_time": 0.0}


def _damaged_tooth(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"tooth_height": 5e-5 * s, "tooth_angle": rng.uniform(-0.3, 0.3), "tooth_width": rng.uniform(0.005, 0.015)}


def _cable(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    width = rng.uniform(0.06, 0.2)
    return {"cable_torque": 0.02 * s * v["rated_torque"], "cable_angle": rng.uniform(-0.2, 0.2), "cable_width": width}


def _contact(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"contact_torque": 0.015 * s * v["rated_torque"]}


def _torque_saturation(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"saturation": min(1.0, 0.4 * s)}


def _gauge_drift(v: Mapping[str, float], s: float, rng: Generator) -> Values:
    return {"gauge_drift": _either(rng) * 0.001 * s * v["rated_torque"]}


KNOWN: dict[str, Make] = {
    "kinematic_error": _kinematic_error,
    "torsional_hysteresis": _torsional_hysteresis,
    "nonlinear_stiffness": _nonlinear_stiffness,
    "backlash": _backlash,
    "load_dependent_friction": _load_dependent_friction,
    "stribeck_friction": _stribeck_friction,
    "asymmetric_friction": _asymmetric_friction,
    "quadratic_drag": _quadratic_drag,
    "temperature_friction": _temperature_friction,
    "presliding": _presliding,
    "motor_cogging": _motor_cogging,
    "torque_constant_error": _torque_constant_error,
    "actuation_delay": _actuation_delay,
    "gauge_ripple": _gauge_ripple,
    "gauge_gain": _gauge_gain,
    "gauge_offset": _gauge_offset,
    "joint_sensor_eccentricity": _joint_sensor_eccentricity,
    "payload": _payload,
    "link_friction": _link_friction,
    "structural_resonance": _structural_resonance,
}
"""Effects of the vocabulary."""
UNNAMED: dict[str, tuple[Make, Outside]] = {
    "viscous_over_angle": (_viscous_over_angle, Outside(("motor_torque",), ("joint_position",))),
    "coulomb_over_angle": (_coulomb_over_angle, Outside(("motor_torque",), ("joint_position",))),
    "viscous_over_load": (
        _viscous_over_load,
        Outside(("motor_torque",), ("joint_torque",), ("load_dependent_friction",)),
    ),
    "friction_jump": (_friction_step, Outside(("motor_torque",), ("time",))),
    "damaged_tooth": (_damaged_tooth, Outside(("transmission",), ("joint_position",))),
    "hose_torque": (_cable, Outside(("link_torque",), ("joint_position",))),
    "passing_contact": (_contact, Outside(("link_torque",), ("time",))),
    "motor_saturation": (_torque_saturation, Outside(("motor_torque",), ("motor_torque", "joint_torque"))),
    "gauge_temperature_drift": (_gauge_drift, Outside(("motor_torque", "link_torque"), ("time", "temperature"))),
}
"""Effects that the vocabulary does not name."""


def hide(plant: Plant, name: str, strength: float) -> Plant:
    """The joint with one more effect; what is random in it depends on the joint's seed and the name only.

    Raises ConfigError for an unknown name.
    """
    make = KNOWN.get(name) or (UNNAMED[name][0] if name in UNNAMED else None)
    if make is None:
        raise ConfigError(f"unknown effect {name!r}; the second world has {', '.join((*KNOWN, *UNNAMED))}")
    values = make(plant.values, strength, stream(plant.seed, f"hidden/{name}"))
    middle = plant.room().middle
    return plant.with_values({key: float(value) + middle * (key in PLACES) for key, value in values.items()})


def in_recording(plant: Plant, number: int, seconds: float) -> Plant:
    """The joint during its recording `number`: when something touches it, and when its friction changes.

    The change happens in the first recording and stays.
    """
    rng, changed = stream(plant.seed, f"events/{number}"), dict[str, float]()
    if plant.values["friction_step"] != 0.0:
        changed["friction_step_time"] = float(rng.uniform(0.3, 0.7)) * seconds if number == 0 else 0.0
    windows: list[Window] = []
    if plant.values["contact_torque"] != 0.0:
        starts = np.sort(rng.uniform(0.05, 0.85, int(rng.integers(3, 7)))) * seconds
        windows = [(float(start), float(start + rng.uniform(0.03, 0.08) * seconds)) for start in starts]
    return plant.with_values(changed, tuple(windows))


def true_parameters(name: str, v: Mapping[str, float]) -> tuple[dict[str, float], bool]:
    """Values by the parameter names of the vocabulary, as far as both laws mean the same by them, and whether the
    laws are the same altogether."""
    rates = {"friction_offset": v["coulomb"] * v["coulomb_asymmetry"]}
    if v["viscous_asymmetry"] != 0.0:
        rates["viscous_asymmetry"] = v["viscous"] * v["viscous_asymmetry"]
    delay = v["transport_delay"] + (0.0 if v["torque_at_stamp"] else v["current_lag"])
    disc = {
        "cosine_1": -v["eccentricity"] * np.sin(v["eccentricity_angle"]),
        "sine_1": v["eccentricity"] * np.cos(v["eccentricity_angle"]),
        "cosine_2": -v["ellipticity"] * np.sin(2.0 * v["ellipticity_angle"]),
        "sine_2": v["ellipticity"] * np.cos(2.0 * v["ellipticity_angle"]),
    }
    added = {
        "gravity_cosine": -v["payload_gravity"] * np.sin(v["payload_angle"]),
        "gravity_sine": v["payload_gravity"] * np.cos(v["payload_angle"]),
    }
    table: dict[str, tuple[dict[str, float], bool]] = {
        "kinematic_error": ({f"{k}_2": v[f"kinematic_{k}_2"] for k in ("cosine", "sine")}, False),
        "backlash": ({"half_gap": v["half_gap"]}, False),
        "stribeck_friction": ({"stribeck_ratio": 1.0 + v["stribeck_excess"]}, False),
        "asymmetric_friction": (rates, True),
        "motor_cogging": ({"cogging_order": v["cogging_order"], "cogging_amplitude": v["cogging"]}, True),
        "torque_constant_error": ({"torque_constant_error": v["torque_constant_error"]}, True),
        "actuation_delay": ({"delay": delay}, True),
        "gauge_ripple": ({f"{k}_2": v[f"gauge_{k}_2"] for k in ("cosine", "sine")}, True),
        "gauge_gain": ({"gauge_gain_error": v["gauge_gain"]}, True),
        "gauge_offset": ({"gauge_offset": v["gauge_offset"]}, True),
        "joint_sensor_eccentricity": (disc, True),
        "payload": (added, True),
        "link_friction": ({"link_coulomb": v["link_coulomb"], "link_viscous": v["link_viscous"]}, True),
        "structural_resonance": (
            {
                "frequency": v["swinging_frequency"],
                "damping_ratio": v["swinging_damping"],
                "inertia_share": v["swinging_share"],
            },
            True,
        ),
    }
    values, same = table.get(name, ({}, False))
    return {key: float(value) for key, value in values.items()}, same
