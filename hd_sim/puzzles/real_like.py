"""Recordings as real robots give them: fewer signals, lower rates, torque and angle noisy, smoothed or repeated.

The joint is one of the second world, most often with nothing hidden: what the diagnosis then names is a false name.
`make_real_like_pair(seed)` draws how the recording was spoilt; the record of a campaign says it as `features`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt, lfilter

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_sim.puzzles.draw import Case
from hd_sim.puzzles.recordings import Pair
from hd_sim.puzzles.second import make_second_pair
from hd_sim.second_world.plant import stream

REAL_LIKE = "real_like"
TORQUES = ("white", "coloured", "smoothed_zero_phase", "smoothed_causal", "averaged", "repeated")
"""What happened to the motor torque before it was stored."""
ANGLES = ("plain", "noisy", "vibrating")
"""What happened to the angles."""
RATES = (100, 125, 200, 500, 1000)
"""Hz; each divides 1 kHz."""
MOTOR, JOINT, GAUGE, TORQUE = "motor_shaft_position", "joint_position", "gauge_torque", "motor_torque"
SIGNALS: Mapping[str, tuple[str, ...]] = {
    "all": (MOTOR, JOINT, GAUGE, TORQUE),
    "joint_angle_and_motor_torque": (JOINT, TORQUE),
    "motor_angle_and_motor_torque": (MOTOR, TORQUE),
    "joint_angle_and_gauge": (JOINT, GAUGE),
    "no_joint_angle": (MOTOR, GAUGE, TORQUE),
    "no_motor_torque": (MOTOR, JOINT, GAUGE),
    "no_gauge": (MOTOR, JOINT, TORQUE),
}
"""Which signals were stored: all four, or the sets of the method's table of missing signals."""
SINGLE_SHARE = 0.3
"""Of the joints that hide one effect; the others hide nothing."""


def draw_features(seed: int) -> dict[str, Any]:
    """How the recordings of a seed were spoilt."""
    rng = stream(seed, "real-like")
    return {
        "torque": str(rng.choice(TORQUES)),
        "torque_noise": float(np.exp(rng.uniform(np.log(1e-3), np.log(2e-2)))),
        "torque_corner": float(np.exp(rng.uniform(np.log(3.0), np.log(20.0)))),
        "repeats": int(rng.integers(2, 6)),
        "angle": str(rng.choice(ANGLES)),
        "angle_noise": float(np.exp(rng.uniform(np.log(3e-6), np.log(1e-4)))),
        "vibration": float(rng.uniform(12.0, 45.0)),
        "rate": int(rng.choice(RATES)),
        "signals": str(rng.choice(list(SIGNALS))),
        "temperature": bool(rng.random() < 0.5),
    }


def make_real_like_pair(seed: int, category: str = "mix") -> Pair:
    """The pair of a seed; `category`: mix, none or one. Raises ConfigError for another one."""
    if category == "mix":
        category = "one" if stream(seed, "real-like/what").random() < SINGLE_SHARE else "none"
    if category not in ("none", "one"):
        raise ConfigError(f"category {category!r}: real-like recordings hide nothing or one effect")
    clean, features = make_second_pair(seed, category), draw_features(seed)
    ratio, both = float(clean.model["gear_ratio"]), (clean.fit, clean.held_out)
    fit, held_out = (spoil(columns, features, ratio, seed, number) for number, columns in enumerate(both))
    case: Case = replace(clean.case, world=REAL_LIKE, features=features, step="")
    joints = {name: _before_spoiling(joint) for name, joint in clean.truth["joints"].items()}
    truth = {**clean.truth, "case": case.to_dict(), "joints": joints}
    return Pair(case, 1.0 / features["rate"], fit, held_out, clean.model, truth)


def _before_spoiling(joint: Mapping[str, Any]) -> dict[str, Any]:
    """The truth of a joint; what the oracle saw was in the clean recording, so it is named so."""
    kept = {name: value for name, value in joint.items() if name != "visibility"}
    return kept | {"visibility_unspoilt": joint["visibility"]}


def spoil(
    columns: Mapping[str, FloatArray], features: Mapping[str, Any], gear_ratio: float, seed: int, number: int
) -> dict[str, FloatArray]:
    """The columns (n,) at 1 kHz as the other recorder stored them, at its own rate and with its signals only."""
    rng, step = stream(seed, f"spoilt/{number}"), 1000 // int(features["rate"])
    found = dict(columns)
    found[TORQUE] = spoilt_torque(columns[TORQUE], features, rng, step)
    shaken = spoilt_angle(columns[JOINT].size, features, rng)
    found[JOINT] = columns[JOINT] + shaken
    found[MOTOR] = columns[MOTOR] + gear_ratio * shaken
    kept = ("time", "reference_position", *SIGNALS[features["signals"]], *(["temperature"] * features["temperature"]))
    return {name: np.ascontiguousarray(found[name][::step]) for name in kept}


def spoilt_torque(torque: FloatArray, features: Mapping[str, Any], rng: np.random.Generator, step: int) -> FloatArray:
    """The motor torque (n,) at 1 kHz, N m, as a drive reports it. `torque_noise` is a share of its own size."""
    kind, size = features["torque"], features["torque_noise"] * float(np.std(torque))
    low = butter(2, features["torque_corner"] / 500.0)
    noise = size * rng.standard_normal(torque.size)
    if kind == "coloured":
        slow = lfilter(*low, rng.standard_normal(torque.size))
        found: FloatArray = torque + size * slow / np.std(slow)
    elif kind == "smoothed_zero_phase":
        found = filtfilt(*low, torque + noise)
    elif kind == "smoothed_causal":
        start = torque[0] * np.ones(1)
        found = lfilter(*low, torque - start + noise) + start
    elif kind == "averaged":
        sums = np.concatenate([[0.0], np.cumsum(torque)])
        last = np.arange(1, torque.size + 1)
        first = np.maximum(last - step, 0)
        found = (sums[last] - sums[first]) / (last - first) + noise
    else:
        found = torque + noise
    if kind == "repeated":
        held = step * int(features["repeats"])
        found = found[np.arange(torque.size) // held * held]
    return found


def spoilt_angle(count: int, features: Mapping[str, Any], rng: np.random.Generator) -> FloatArray:
    """What is added to the joint angle, (n,) rad; `angle_noise` is its standard deviation."""
    kind, size = features["angle"], features["angle_noise"]
    if kind == "plain":
        return np.zeros(count)
    noise: FloatArray = rng.standard_normal(count)
    if kind == "vibrating":
        middle = features["vibration"] / 500.0
        noise = lfilter(*butter(2, [0.9 * middle, 1.1 * middle], "bandpass"), noise)
    scaled: FloatArray = size * noise / np.std(noise)
    return scaled
