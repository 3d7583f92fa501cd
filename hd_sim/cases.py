"""What a challenge hides: the draw of effects, strengths, excitation and of worlds that differ from the model library.

A seed determines the case completely. Ranges and shares are in `config/challenge.yaml`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_sim.effects import VOCABULARY
from hd_sim.random_drive import ranges, stream
from hd_sim.random_motion import POOR
from hd_sim.truth import HiddenEffect

CATEGORIES = ("none", "one", "two", "unknown", "poor")
STEPS = ("weak", "middle", "strong")


@dataclass(frozen=True)
class Unknown:
    """Right answers for an effect that no library names: channels and variables it depends on; names that also do."""

    channels: tuple[str, ...]
    variables: tuple[str, ...]
    also: tuple[str, ...] = ()


UNKNOWN: Mapping[str, Unknown] = {
    "friction_over_angle": Unknown(("motor_torque",), ("joint_position",)),
    "cable_torque": Unknown(("link_torque",), ("joint_position",)),
    "friction_step": Unknown(("motor_torque",), ("time",)),
    "tooth_defect": Unknown(("transmission",), ("joint_position",)),
    "torque_constant_saturation": Unknown(("motor_torque",), ("motor_torque", "joint_torque")),
    "gauge_zero_drift": Unknown(("motor_torque", "link_torque"), ("time", "temperature")),
    "contact_pulses": Unknown(("link_torque",), ("time",)),
    "gauge_fourth_harmonic": Unknown(
        ("motor_torque", "link_torque", "transmission"), ("motor_shaft_position",), ("gauge_ripple",)
    ),
}
"""The effects of `effects.OUTSIDE` that are unknown to a model, with what a right answer says."""

SUBSTITUTES = {"torsional_hysteresis": "maxwell_slip_hysteresis", "presliding": "maxwell_slip_friction"}
"""Effects that a judge's world makes with another law; the right name stays that of the library."""
FEATURES = ("scheme", "friction_law", "current_lag", "sampling_jitter", "gauge_lag", "skew", "other_laws", "kinematic")
TOLERATED = {
    "friction_law": ("presliding",),
    "current_lag": ("actuation_delay",),
    "gauge_lag": ("unknown",),
    "kinematic": ("unknown",),
    "skew": ("actuation_delay", "unknown"),
}
"""Answers that a judge's feature also justifies; they count neither as right nor as wrong."""


@dataclass(frozen=True)
class Case:
    """One challenge. `effects` act in the world; `names` are their right names in the vocabulary; `unknown` the hidden
    effects without one; `features` of a judge's world with their sizes; `motion` names the kind of recording."""

    seed: int
    category: str
    effects: tuple[HiddenEffect, ...]
    names: tuple[str, ...]
    unknown: tuple[str, ...]
    step: str
    motion: str
    features: Mapping[str, Any]

    @property
    def tolerated(self) -> tuple[str, ...]:
        """Names that count neither as right nor as wrong."""
        also = [name for effect in self.unknown for name in UNKNOWN[effect].also]
        return tuple(sorted({*also, *(name for key in self.features for name in TOLERATED.get(key, ()))}))

    def to_dict(self) -> dict[str, Any]:
        """The case in plain types."""
        return asdict(self) | {"tolerated": list(self.tolerated), "features": dict(self.features)}


def draw_case(seed: int, category: str = "mix", judge: bool | None = None) -> Case:
    """A case of one category, or of the mix. `judge`: in a world that differs from the library or not; None: drawn.

    Raises ConfigError for an unknown category.
    """
    table, rng = ranges(), stream(seed, "case")
    shares = [table["mix"][name] for name in CATEGORIES]
    drawn = CATEGORIES[int(rng.choice(len(CATEGORIES), p=np.array(shares) / sum(shares)))]
    category = drawn if category == "mix" else category
    if category not in CATEGORIES:
        raise ConfigError(f"category {category!r}: expected mix or one of {', '.join(CATEGORIES)}")
    step = STEPS[int(rng.integers(3))]
    strengths = [float(np.exp(rng.uniform(*np.log(table["strength"][step])))) for _ in range(2)]
    known = [str(name) for name in rng.permutation(VOCABULARY)[:2]]
    outside = str(rng.choice(list(UNKNOWN)))
    motion = str(rng.choice(list(POOR))) if category == "poor" else "general"
    with_known, with_effect = (rng.random() < table[k] for k in ("unknown_with_known_share", "poor_with_effect_share"))
    count = {"none": 0, "one": 1, "two": 2, "unknown": int(with_known), "poor": int(with_effect)}[category]
    names = tuple(known[:count])
    hidden = [*names, outside] if category == "unknown" else list(names)
    step = step if hidden else ""
    features = draw_features(seed, names, judge)
    effects = [
        HiddenEffect(0, SUBSTITUTES.get(name, name) if "other_laws" in features else name, strength)
        for name, strength in zip(hidden, strengths, strict=False)
    ]
    unknown = (outside,) if category == "unknown" else ()
    return Case(seed, category, tuple(effects), names, unknown, step, motion, features)


def chosen_case(seed: int, effects: Mapping[str, float], motion: str = "general", judge: bool = False) -> Case:
    """A case with given effects and strengths; unknown ones by their name in `hd_sim.effects`."""
    names = tuple(name for name in effects if name in VOCABULARY)
    unknown = tuple(name for name in effects if name in UNKNOWN)
    missing = [name for name in effects if name not in (*names, *unknown)]
    if missing:
        raise ConfigError(f"unknown effect {missing[0]!r}; there is {', '.join((*VOCABULARY, *UNKNOWN))}")
    category = "poor" if motion != "general" else "unknown" if unknown else ("none", "one", "two")[min(len(names), 2)]
    hidden = tuple(HiddenEffect(0, name, strength) for name, strength in effects.items())
    return Case(seed, category, hidden, names, unknown, "", motion, draw_features(seed, names, judge))


def draw_features(seed: int, names: tuple[str, ...], judge: bool | None) -> dict[str, Any]:
    """What is different in this world, feature by feature with its size; empty in a clean world."""
    table, rng = ranges(), stream(seed, "judge")
    wanted = rng.random() < table["judge_share"] if judge is None else judge
    present = {name: rng.random() < table["judge_feature_share"] for name in FEATURES}
    sizes = {key: float(np.exp(rng.uniform(*np.log(pair)))) for key, pair in table["judge"].items()}
    law, channel = str(rng.choice(["bristle", "maxwell_slip"])), str(rng.choice(list(SKEWED)))
    if not wanted:
        return {}
    values: dict[str, Any] = {
        "scheme": "first_order",
        "friction_law": {"law": law, "distance": sizes["friction_distance"]},
        "current_lag": sizes["current_lag"],
        "sampling_jitter": sizes["sampling_jitter"],
        "gauge_lag": sizes["gauge_lag"],
        "skew": {"channel": channel, "delay": sizes["skew"]},
        "other_laws": True,
        "kinematic": {"growth": sizes["kinematic_growth"], "modulation": sizes["kinematic_modulation"]},
    }
    useful = {"other_laws": bool(set(names) & set(SUBSTITUTES)), "kinematic": "kinematic_error" in names}
    if "presliding" in names:
        useful["friction_law"] = False
    return {name: values[name] for name in FEATURES if useful.get(name, True) and (present[name] or name in useful)}


SKEWED = ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque")
"""Channels that a recorder may deliver late."""
