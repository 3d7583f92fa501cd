"""Checks of signals: silent on right signals of random joints, loud on each defect, with the right numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from hd_control.lab.signals.checks import check_signals
from hd_control.lab.signals.joint_signals import SIGNALS, JointSignals
from hd_sim.puzzles.recordings import make_pair

SEEDS = (30400, 30401, 30403, 30405)
"""Development seeds with good recordings; the thresholds were set on others."""


@lru_cache(maxsize=8)
def healthy(seed: int, kind: str = "one") -> tuple[JointSignals, float, float]:
    """(signals, gear ratio, rated torque) of a random joint with one hidden effect."""
    pair = make_pair(seed, kind, judge=False)
    columns = {name: np.asarray(pair.fit[name]) for name in SIGNALS}
    time = np.asarray(pair.fit["time"])
    signals = JointSignals("joint_1", time, pair.period, np.ones(time.size, bool), **columns)
    return signals, float(pair.model["gear_ratio"]), float(pair.model["rated_torque"])


def late(column: np.ndarray, samples: int) -> np.ndarray:
    """The column some samples later (earlier if negative), its ends held."""
    index = np.clip(np.arange(column.size) - samples, 0, column.size - 1)
    return column[index]


def stuck(column: np.ndarray) -> np.ndarray:
    """The column with 20 s at one value, or half of a short recording."""
    found, first = column.copy(), min(5000, column.size // 4)
    found[first : first + min(20_000, column.size // 2)] = found[first]
    return found


@pytest.mark.parametrize("seed", range(30410, 30422))
def test_right_signals_get_no_sentence(seed: int) -> None:
    kind = ("none", "one", "two", "poor")[seed % 4]
    signals, ratio, rated = healthy(seed, kind)
    sentences = check_signals(signals, ratio, rated)
    true_delay = signals_are_late(seed, kind)
    limited = [text for text in sentences if "saturated" in text]
    assert not limited or signals_are_limited(signals)
    assert [text for text in sentences if text not in limited] == [] or true_delay


def signals_are_late(seed: int, kind: str) -> bool:
    """True if the world of the seed holds the torque back, which is a delay that may be said."""
    return "actuation_delay" in make_pair(seed, kind, judge=False).case.names


def signals_are_limited(signals: JointSignals) -> bool:
    """True if the motor torque rests at its extreme for more than ten samples on end."""
    torque = np.abs(signals.motor_torque)
    at = np.flatnonzero(torque == torque.max())
    return at.size > 10 and bool((np.diff(at) == 1).sum() > 10)


DEFECTS: dict[str, tuple[Callable[[JointSignals], JointSignals], str]] = {
    "flipped gauge": (lambda s: replace(s, gauge_torque=-s.gauge_torque), "sign of gauge_torque looks flipped"),
    "flipped motor": (lambda s: replace(s, motor_torque=-s.motor_torque), "sign of motor_torque looks flipped"),
    "flipped motor without a gauge": (
        lambda s: replace(s, motor_torque=-s.motor_torque, gauge_torque=None),
        "sign of motor_torque looks flipped",
    ),
    "flipped gauge alone": (
        lambda s: replace(s, gauge_torque=-s.gauge_torque, motor_torque=None, motor_shaft_position=None),
        "sign of gauge_torque looks flipped",
    ),
    "turned encoder": (lambda s: replace(s, motor_shaft_position=-s.motor_shaft_position), "opposite signs"),
    "joint in degrees": (
        lambda s: replace(s, joint_position=np.degrees(s.joint_position)),
        "joint_position reaches .* looks like degrees",
    ),
    "motor in degrees": (
        lambda s: replace(s, motor_shaft_position=np.degrees(s.motor_shaft_position)),
        "motor_shaft_position .* looks like degrees",
    ),
    "motor in milli newton": (lambda s: replace(s, motor_torque=1e3 * s.motor_torque), "mN m"),
    "kelvin": (lambda s: replace(s, temperature=s.temperature + 273.15), "looks like kelvin"),
    "fahrenheit of a hot motor": (
        lambda s: replace(s, temperature=(s.temperature + 50.0) * 1.8 + 32.0),
        "looks like degrees Fahrenheit",
    ),
    "wrapped encoder": (
        lambda s: replace(s, motor_shaft_position=np.mod(s.motor_shaft_position, 2 * np.pi)),
        "motor_shaft_position jumps .* wraps at 2 pi",
    ),
    "stuck resolver": (lambda s: replace(s, joint_position=stuck(s.joint_position)), "joint_position is stuck"),
    "stuck encoder": (
        lambda s: replace(s, motor_shaft_position=stuck(s.motor_shaft_position)),
        "motor_shaft_position is stuck",
    ),
    "dead gauge": (lambda s: replace(s, gauge_torque=np.full(s.time.size, 1.5)), "gauge_torque never changes"),
    "saturated motor": (
        lambda s: replace(s, motor_torque=np.clip(s.motor_torque, None, np.percentile(s.motor_torque, 98.0))),
        "motor_torque is at its limit .* saturated",
    ),
}


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("seed", SEEDS)
def test_each_defect_is_seen(seed: int, defect: str) -> None:
    signals, ratio, rated = healthy(seed)
    spoil, says = DEFECTS[defect]
    sentences = check_signals(spoil(signals), ratio, rated)
    assert any(re.search(says, text) for text in sentences), sentences


@pytest.mark.parametrize("seed", SEEDS)
def test_a_torque_before_the_gear_is_seen_with_and_without_a_gauge(seed: int) -> None:
    signals, ratio, rated = healthy(seed)
    small = replace(signals, motor_torque=signals.motor_torque / ratio)
    for spoiled, known in ((small, rated), (small, None), (replace(small, gauge_torque=None), rated)):
        sentences = check_signals(spoiled, ratio, known)
        assert any("torque of the motor itself" in text for text in sentences), sentences


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_gear_ratio_is_named_with_the_right_one(seed: int) -> None:
    signals, ratio, rated = healthy(seed)
    for wrong in (ratio + 1.0, ratio - 1.0, round(1.3 * ratio)):
        (sentence,) = [text for text in check_signals(signals, wrong, rated) if "gear ratio" in text]
        numbers = re.search(r"motor turns ([\d.]+) per joint turn, the model says ([\d.]+)", sentence)
        assert numbers, sentence
        assert float(numbers[1]) == pytest.approx(ratio, rel=1e-4) and float(numbers[2]) == wrong
    divided = replace(signals, motor_shaft_position=signals.motor_shaft_position / ratio)
    assert any("already divided by the gear ratio" in text for text in check_signals(divided, ratio, rated))


@pytest.mark.parametrize(("name", "samples"), [("joint_position", 3), ("joint_position", -6), ("motor_torque", 8)])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_delay_is_named_with_its_size(seed: int, name: str, samples: int) -> None:
    signals, ratio, rated = healthy(seed)
    spoiled = replace(signals, **{name: late(getattr(signals, name), samples)})
    (sentence,) = [text for text in check_signals(spoiled, ratio, rated) if "shifted in time" in text]
    found = re.search(rf"{name} [\d.]+ ms \(([\d.]+) samples\) (late|early)", sentence)
    assert found, sentence
    size = float(found[1]) if found[2] == "late" else -float(found[1])
    assert size == pytest.approx(samples, abs=0.2 if name == "joint_position" else 2.0)


@pytest.mark.parametrize("present", [("joint_position",), ("motor_torque",), ("motor_shaft_position", "gauge_torque")])
def test_few_signals_few_seconds_and_rest_are_no_reason_to_fail(present: tuple[str, ...]) -> None:
    signals, ratio, rated = healthy(SEEDS[0])
    few = replace(signals, **{name: None for name in SIGNALS if name not in present})
    assert check_signals(few, ratio, rated) == ()
    short = replace(
        few, time=few.time[:1000], valid=few.valid[:1000], **{name: getattr(few, name)[:1000] for name in present}
    )
    assert check_signals(short, ratio, rated) == ()


def test_gaps_do_not_disturb() -> None:
    signals, ratio, rated = healthy(SEEDS[0])
    valid = np.ones(signals.time.size, bool)
    valid[10_000:10_400] = valid[40_000:40_010] = False
    holes = {name: np.where(valid, getattr(signals, name), np.nan) for name in SIGNALS[:4]}
    assert check_signals(replace(signals, valid=valid, **holes), ratio, rated) == ()
    flipped = {**holes, "gauge_torque": -holes["gauge_torque"]}
    assert any("flipped" in text for text in check_signals(replace(signals, valid=valid, **flipped), ratio, rated))
