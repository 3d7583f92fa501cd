"""Puzzles of the second world: what is hidden in a joint, how clearly, its recordings, data sheet and truth.

pair = make_second_pair(seed, "one")   # columns, model and truth as in `recordings.Pair`
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_sim.puzzles.draw import CATEGORIES, Case, ranges
from hd_sim.puzzles.recordings import FIT_S, HELD_OUT_S, Pair
from hd_sim.second_world.hidden import KNOWN, UNNAMED, hide, in_recording, true_parameters
from hd_sim.second_world.motion import MOTIONS, POOR
from hd_sim.second_world.plant import JOINT, PERIOD, Plant, draw_plant, simulate, stream
from hd_sim.second_world.visibility import contributions, data_sheet_columns, make_filter, oracle_gain
from hd_sim.truth import HiddenEffect

SECOND = "second"
FAINT, CLEAR = 1.0e3, 1.0e4
"""nats of the oracle: a hidden effect is barely visible below the first, clear above the other."""
TARGETS = (2.0e2, 2.0e5)
"""nats of the oracle in a general recording of 60 s between which strengths are drawn, evenly in the logarithm."""
STRENGTHS = (0.02, 5.0)
PROBE_S = 15.0
"""s of the first recording that relates strength to gain."""
ALWAYS_VISIBLE = 100.0
"""nats above which something that this world always has may be named."""
LATES = ("encoder_late", "resolver_late", "gauge_late", "torque_late")
SHAPES = ("faint", "middle", "clear")


@dataclass(frozen=True)
class SecondBench:
    """A joint of the second world with everything that is hidden in it: any number of recordings."""

    case: Case
    plain: Plant
    plant: Plant

    def record(self, motion: str, number: int = 0, seconds: float = FIT_S) -> dict[str, FloatArray]:
        """Recording `number` of a kind of motion; each number has its own trajectory and noise."""
        return self._play(motion, number, seconds)[1]

    def _play(self, motion: str, number: int, seconds: float) -> tuple[Plant, dict[str, FloatArray], Any]:
        plant = in_recording(self.plant, number, seconds)
        reference = MOTIONS[motion](stream(plant.seed, f"motion/{motion}/{number}"), plant.room(), seconds)
        if number:
            rng, rise = stream(plant.seed, f"start/{number}"), 8.0
            warm = plant.values["ambient_temperature"] + float(rng.uniform(0.0, 0.7)) * rise
            plant = plant.with_values({"start_temperature": warm})
        return (plant, *simulate(plant, reference, number))

    def gains(self, truths: Mapping[str, FloatArray], played: Plant) -> dict[str, float]:
        """nats of the oracle for every hidden effect and for what this world always has."""
        predictor = make_filter(played, truths)
        names = [effect.name for effect in self.case.effects]
        each = {name: contributions(played, _without(self, name, played), truths) for name in names}
        known = data_sheet_columns(played, truths)
        found = {}
        for name in names:
            beside = [column for other, column in each.items() if other != name]
            found[name] = oracle_gain(predictor, each[name], [*known, *beside])
        for name, values in _always(played).items():
            column = contributions(played, played.with_values(values), truths)
            found[f"always/{name}"] = oracle_gain(predictor, column, [*known, *each.values()])
        return found


def _always(plant: Plant) -> dict[str, dict[str, float]]:
    """Name that may stand for it -> values that switch it off."""
    lag = {"current_lag": 1e-9, **dict.fromkeys(LATES, 0.0)}
    return {"motor_cogging": {"ripple_share": 0.0}, "actuation_delay": lag}


def _without(bench: SecondBench, name: str, played: Plant) -> Plant:
    """The joint as it was played, without one of its hidden effects."""
    plant = bench.plain
    for effect in bench.case.effects:
        if effect.name != name:
            plant = hide(plant, effect.name, effect.strength)
    kept = {key: played.values[key] for key in ("start_temperature", "friction_step_time")}
    windows = played.windows if plant.values["contact_torque"] else ()
    return plant.with_values(kept, windows)


def neutral_names(plant: Plant, gains: Mapping[str, float]) -> dict[str, dict[str, tuple[float, float]]]:
    """What this joint always has and somebody may name, with the bounds within which it is neither right nor wrong."""
    v = plant.values
    found: dict[str, dict[str, tuple[float, float]]] = {"presliding": {}}
    if gains.get("always/motor_cogging", 0.0) > ALWAYS_VISIBLE:
        order = v["ripple_order"]
        found["motor_cogging"] = {"cogging_order": (order - 0.2, order + 0.2)}
    if gains.get("always/actuation_delay", 0.0) > ALWAYS_VISIBLE:
        found["actuation_delay"] = {"delay": (0.0, 1.5 * (v["current_lag"] + max(v[name] for name in LATES)))}
    return found


def draw_second(seed: int, category: str = "mix") -> tuple[Case, dict[str, float]]:
    """The case of a seed, strengths still 1, and the gain in nats that each hidden effect is to have.

    Raises ConfigError for an unknown category.
    """
    rng, table = stream(seed, "case"), ranges()
    shares = np.array([table["mix"][name] for name in CATEGORIES])
    drawn = CATEGORIES[int(rng.choice(len(CATEGORIES), p=shares / shares.sum()))]
    category = drawn if category == "mix" else category
    if category not in CATEGORIES:
        raise ConfigError(f"category {category!r}: expected mix or one of {', '.join(CATEGORIES)}")
    known = [str(name) for name in rng.permutation(list(KNOWN))[:2]]
    outside, poor = str(rng.choice(list(UNNAMED))), str(rng.choice(list(POOR)))
    beside, within = rng.random() < table["unknown_with_known_share"], rng.random() < table["poor_with_effect_share"]
    targets = np.exp(rng.uniform(np.log(TARGETS[0]), np.log(TARGETS[1]), 3)).tolist()
    count = {"none": 0, "one": 1, "two": 2, "unknown": int(beside), "poor": int(within)}[category]
    names, unknown = tuple(known[:count]), (outside,) if category == "unknown" else ()
    hidden = (*names, *unknown)
    effects = tuple(HiddenEffect(0, name, 1.0) for name in hidden)
    motion = poor if category == "poor" else "general"
    case = Case(seed, category, effects, names, unknown, "", motion, {}, SECOND)
    return case, dict(zip(hidden, targets, strict=False))


def set_up_second(seed: int, category: str = "mix") -> SecondBench:
    """The joint of a seed with its hidden effects, each as strong as its gain asks for."""
    case, targets = draw_second(seed, category)
    plain = draw_plant(seed)
    effects = tuple(HiddenEffect(0, name, _strength(plain, name, gain)) for name, gain in targets.items())
    return _bench(replace(case, effects=effects), plain)


def chosen_second(seed: int, effects: Mapping[str, float], motion: str = "general") -> SecondBench:
    """The joint of a seed with given effects and strengths. Raises ConfigError for an unknown name."""
    names = tuple(name for name in effects if name in KNOWN)
    unknown = tuple(name for name in effects if name not in KNOWN)
    category = "poor" if motion != "general" else "unknown" if unknown else ("none", "one", "two")[min(len(names), 2)]
    hidden = tuple(HiddenEffect(0, name, strength) for name, strength in effects.items())
    return _bench(Case(seed, category, hidden, names, unknown, "", motion, {}, SECOND), draw_plant(seed))


def _bench(case: Case, plain: Plant) -> SecondBench:
    plant = plain
    for effect in case.effects:
        plant = hide(plant, effect.name, effect.strength)
    return SecondBench(case, plain, plant)


def _strength(plain: Plant, name: str, target: float) -> float:
    """Strength at which the effect alone gains `target` nats in 60 s; gain grows with the square of the strength.

    A short probe first, then one of full length: heat takes its time.
    """
    strength = 0.5
    for seconds in (PROBE_S, FIT_S):
        plant = in_recording(hide(plain, name, strength), 0, seconds)
        reference = MOTIONS["general"](stream(plain.seed, "motion/general/0"), plain.room(), seconds)
        truths = simulate(plant, reference)[1]
        without = plain.with_values({"friction_step_time": plant.values["friction_step_time"]})
        signal = contributions(plant, without, truths)
        gain = oracle_gain(make_filter(plant, truths), signal, list(data_sheet_columns(plant, truths)))
        wanted = strength * np.sqrt(target * seconds / FIT_S / max(gain, 1e-3))
        strength = float(np.clip(wanted, *STRENGTHS))
    return strength


def make_second_pair(seed: int, category: str = "mix") -> Pair:
    """Both recordings of a seed's case; about 2 s of computing."""
    return record_second(set_up_second(seed, category))


def record_second(bench: SecondBench) -> Pair:
    """Both recordings, the user's model, and the truth with the visibility of everything hidden."""
    motion = bench.case.motion
    played, fit, truths = bench._play(motion, 0, FIT_S)
    held_out = bench.record(motion, 1, HELD_OUT_S)
    gains = bench.gains(truths, played)
    weakest = min((gains[effect.name] for effect in bench.case.effects), default=0.0)
    step = SHAPES[int(weakest > FAINT) + int(weakest > CLEAR)] if bench.case.effects else ""
    case = replace(bench.case, neutral=neutral_names(bench.plant, gains), step=step)
    return Pair(case, PERIOD, fit, held_out, second_model(bench.plant), _truth(case, bench, gains))


def second_model(plant: Plant) -> dict[str, Any]:
    """What the user believes, in the names of the model files."""
    said, v = plant.nominal, plant.values
    effects: dict[str, dict[str, float]] = {
        "rotor_inertia": {"rotor_inertia": said["rotor_inertia"]},
        "torsional_stiffness": {"torsional_stiffness": said["stiffness"], "damping_time": said["damping_time"]},
        "coulomb_friction": {"coulomb_torque": said["coulomb"]},
        "viscous_friction": {"viscous": said["viscous"]},
        "link_dynamics": {},
    }
    return {
        "joint": JOINT,
        "gear_ratio": v["gear_ratio"],
        "rated_torque": v["rated_torque"],
        "robot": plant.urdf(),
        "effects": effects,
    }


def _truth(case: Case, bench: SecondBench, gains: Mapping[str, float]) -> dict[str, Any]:
    """The sealed part."""
    parameters = {name: true_parameters(name, bench.plant.values) for name in case.names}
    joint = {
        "names": list(case.names),
        "unknown": list(case.unknown),
        "parameters": {name: values for name, (values, _) in parameters.items()},
        "same_law": [name for name, (_, same) in parameters.items() if same],
        "visibility": dict(gains),
    }
    return {"case": case.to_dict(), "joints": {JOINT: joint}, "world": {"values": dict(bench.plant.values)}}
