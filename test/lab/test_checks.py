"""Checks of signals: silent on right signals of random joints, loud on each defect, with the right numbers.

First each check on columns made for it, then all of them on a plain joint and on joints of the world.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import RATIO, Joint, simulate, with_noise

from hd_control.lab.signals.checks import (
    check_signals,
    degrees,
    examine,
    extent,
    saturated,
    temperature,
    torque_units,
    unwrapped,
)
from hd_control.lab.signals.checks import stuck as stuck_signals
from hd_control.lab.signals.delays import KnownLinks
from hd_control.lab.signals.joint_signals import SIGNALS, JointSignals
from hd_sim.puzzles.recordings import make_pair

SEEDS = (30400, 30401, 30403, 30405)
"""Development seeds with good recordings; the thresholds were set on others."""


PERIOD = 1e-3
TIME = np.arange(8000) * PERIOD
MOTION = 0.8 * np.sin(1.7 * TIME) + 0.1 * np.sin(13.0 * TIME)


def made(**columns: np.ndarray) -> JointSignals:
    """A joint with these columns."""
    return JointSignals("joint", TIME, PERIOD, np.ones(TIME.size, bool), **columns)


@pytest.mark.parametrize(("turn", "name"), [(2.0 * np.pi, "2 pi"), (360.0, "360 degrees")])
def test_wraps_are_counted_named_and_undone(turn: float, name: str) -> None:
    angle = turn * 3.0 * np.sin(0.9 * TIME)
    wrapped = np.mod(angle, turn)
    wrapped[[100, 4000]] = np.nan
    (sentence,), repaired = unwrapped(made(motor_shaft_position=wrapped))
    jumps = int((np.abs(np.diff(wrapped[np.isfinite(wrapped)])) > 0.5 * turn).sum())
    assert f"jumps {jumps} times: it wraps at {name}" in sentence and f"wrap: {turn:.6g}" in sentence
    whole = repaired.motor_shaft_position
    expected = np.where(np.isfinite(wrapped), angle - angle[0] + wrapped[0], np.nan)
    np.testing.assert_allclose(whole, expected, atol=1e-9)


@pytest.mark.parametrize("column", [MOTION, 50.0 * MOTION, np.where(MOTION > 0.0, 6.0, 0.0) + MOTION])
def test_what_moves_far_or_jumps_otherwise_is_no_wrap(column: np.ndarray) -> None:
    """Smooth motion, many turns, and a jump in a range that is larger than a turn."""
    signals = made(motor_shaft_position=column)
    assert unwrapped(signals) == ([], signals)


def test_degrees_are_seen_by_range_and_by_speed() -> None:
    slow = np.sin(0.5 * TIME)
    for scale, sentences in ((1.0, 0), (12.0, 0), (13.0, 1)):  # two turns are 12.57 rad
        assert len(degrees(made(joint_position=scale * slow))) == sentences
    fast = np.sin(15.0 * TIME)  # 15 rad/s within one radian: 12 is more than any such joint turns
    (sentence,) = degrees(made(joint_position=fast))
    assert "looks like degrees, not rad" in sentence
    for speed, sentences in ((1000.0, 0), (2000.0, 1)):
        assert len(degrees(made(motor_shaft_position=speed * TIME))) == sentences
    # Noise of single samples is no speed: it is taken over 20 ms.
    noisy = MOTION + 0.05 * np.random.default_rng(0).standard_normal(TIME.size)
    assert degrees(made(joint_position=noisy)) == []


def test_a_stuck_position_needs_time_and_motion_of_the_other() -> None:
    hold = MOTION.copy()
    hold[2000:2400] = hold[2000]
    (sentence,) = stuck_signals(made(joint_position=hold, motor_shaft_position=100.0 * MOTION), 100.0)
    moved = np.ptp(MOTION[2000:2400])
    assert f"stays at {hold[2000]:.6g} for 0.4 s from 2 s on" in sentence and f"moves by {moved:.3g} rad" in sentence
    (sentence,) = stuck_signals(made(joint_position=MOTION, motor_shaft_position=100.0 * hold), 100.0)
    assert sentence.startswith("motor_shaft_position is stuck")
    short = MOTION.copy()
    short[2000:2150] = short[2000]
    assert stuck_signals(made(joint_position=short, motor_shaft_position=100.0 * MOTION), 100.0) == []
    assert stuck_signals(made(joint_position=hold, motor_shaft_position=100.0 * hold), 100.0) == [], "both rest"
    assert stuck_signals(made(joint_position=hold), 100.0) == []


def test_a_torque_that_never_changes_while_the_joint_moves_is_stuck() -> None:
    flat = np.full(TIME.size, 3.0)
    for columns in ({"joint_position": MOTION}, {"motor_shaft_position": 100.0 * MOTION}):
        (sentence,) = stuck_signals(made(**columns, gauge_torque=flat), 100.0)
        assert sentence == f"gauge_torque never changes while the joint moves by {np.ptp(MOTION):.3g} rad: " + (
            "the signal is stuck"
        )
        assert stuck_signals(made(**{n: 0.005 * c for n, c in columns.items()}, motor_torque=flat), 100.0) == []


@pytest.mark.parametrize(
    ("middle", "says"),
    [(25.0, ""), (110.0, ""), (-40.0, ""), (298.0, "kelvin"), (130.0, "Fahrenheit"), (-80.0, "not a motor's"),
     (2980.0, "not a motor's")],
)  # fmt: skip
def test_temperatures_of_other_scales(middle: float, says: str) -> None:
    found = temperature(made(temperature=middle + np.sin(TIME)))
    assert (found == []) if not says else (len(found) == 1 and says in found[0])
    assert temperature(made(temperature=np.full(TIME.size, np.nan))) == [] == temperature(made())


def test_rest_at_a_limit_is_counted_in_runs() -> None:
    """Clipped at 9: the share of the time there. Single largest samples and a limit at little torque are none."""
    torque = np.clip(10.0 * np.sin(2.0 * TIME), None, 9.0)
    (sentence,) = saturated(made(motor_torque=torque))
    share = 100.0 * np.mean(torque == 9.0)
    assert sentence == f"motor_torque is at its limit of 9 N m for {share:.2g} % of the time: saturated"
    (low,) = saturated(made(gauge_torque=-torque))
    assert "limit of -9 N m" in low
    assert saturated(made(motor_torque=10.0 * np.sin(2.0 * TIME))) == []
    assert saturated(made(motor_torque=np.clip(10.0 * np.sin(2.0 * TIME), -1.0, None))) == [], "-1 of 10 is no limit"
    assert saturated(made(motor_torque=np.full(TIME.size, 5.0))) == []


@pytest.mark.parametrize(
    ("name", "peak", "says"),
    [("gauge_torque", 40.0, ""), ("gauge_torque", 40e3, "mN m"), ("gauge_torque", 0.4, ""),
     ("motor_torque", 0.4, "the torque of the motor itself, not times the gear ratio 100"), ("motor_torque", 4.0, "")],
)  # fmt: skip
def test_torques_are_held_against_what_the_joint_is_rated_for(name: str, peak: float, says: str) -> None:
    signals = made(**{name: peak * np.sin(TIME)})
    found = torque_units(signals, 100.0, 60.0)
    assert (found == []) if not says else (len(found) == 1 and says in found[0])
    assert torque_units(signals, 100.0, None) == [] == torque_units(signals, 100.0, 0.0)


def test_the_extent_leaves_out_what_is_missing() -> None:
    assert extent(np.array([1.0, np.nan, -2.0])) == 3.0 and extent(np.full(3, np.nan)) == 0.0


PLAIN = Joint()


@lru_cache(maxsize=1)
def plain() -> JointSignals:
    """The joint of two masses with a good sensor's noise."""
    return with_noise(simulate())


def test_a_plain_joint_gets_no_sentence_whatever_is_recorded_of_it() -> None:
    for missing in ((), ("gauge_torque",), ("motor_torque",), ("joint_position",), ("gauge_torque", "joint_position")):
        assert check_signals(replace(plain(), **dict.fromkeys(missing)), RATIO, 30.0) == (), missing


@pytest.mark.parametrize(
    ("spoiled", "says"),
    [
        ({"gauge_torque": -1.0}, "sign of gauge_torque looks flipped: with it inertia and friction come out negative"),
        ({"motor_torque": -1.0}, "sign of motor_torque looks flipped"),
        ({"motor_shaft_position": -1.0}, "opposite signs: slope -100"),
        ({"motor_shaft_position": 1.01}, "the motor turns 101 per joint turn, the model says 100"),
        ({"motor_shaft_position": 0.01}, "already divided by the gear ratio: it turns 1 per"),
        ({"motor_torque": 0.01}, "torque of the motor itself, not times the gear ratio 100"),
        ({"motor_torque": 1e3}, "differ by a factor of 1000, as N m and mN m"),
        ({"gauge_torque": 1e3}, "differ by a factor of 0.001, as N m and kN m"),
        ({"gauge_torque": 20.0}, "differ by a factor of 0.0"),
    ],
)
def test_each_contradiction_of_a_plain_joint_is_named_alone(spoiled: dict[str, float], says: str) -> None:
    """Without a rated torque: what contradicts is the balances."""
    columns = {name: factor * getattr(plain(), name) for name, factor in spoiled.items()}
    found = check_signals(replace(plain(), **columns), RATIO)
    assert len(found) == 1 and says in found[0], found


def described(factor: float = 1.0) -> KnownLinks:
    """What a description says of the plain joint's link, times a factor."""
    q = plain().joint_position
    acceleration = np.gradient(np.gradient(np.convolve(q, np.ones(25) / 25.0, "same"), 1e-3), 1e-3)
    return KnownLinks(PLAIN.link_inertia * acceleration, factor * PLAIN.gravity * np.sin(q))


ONLY_ANGLE_AND_DRIVE = {"gauge_torque": None, "motor_shaft_position": None}


@pytest.mark.parametrize(
    ("torque", "gravity", "says"),
    [
        (1.0, 1.0, ""),
        (1.0, 0.6, ""),  # a payload
        (1.0, 2.0, ""),
        (
            0.01,
            1.0,
            "motor_torque shows 0.010.? of the gravity .* torque of the motor itself, not times the gear",
        ),
        (1e3, 1.0, "motor_torque shows 1.*e.03 of the gravity .* factor 1000, as N m and mN m"),
        (1.0, 4.0, "motor_torque shows 0.25.? of the gravity that the robot description says: the robot description"),
        (1.0, -1.0, "looks flipped: it shows -1.* of the gravity"),
    ],
)
def test_gravity_of_the_description_shows_unit_scale_and_sign(torque: float, gravity: float, says: str) -> None:
    """Without a gauge and a rated torque nothing else would."""
    whole = replace(plain(), **ONLY_ANGLE_AND_DRIVE, motor_torque=torque * plain().motor_torque)
    found = examine(whole, RATIO, links=described(gravity))
    assert len(found.contradictions) == (1 if says else 0), found.contradictions
    if says:
        assert re.search(says, found.contradictions[0]) and found.contradictions[0] in found.sentences
        assert found.delays == (), "beside a contradiction no delay means anything"


def test_what_is_odd_is_no_contradiction() -> None:
    """Delays, wraps, stuck sensors and kelvin do not keep a diagnosis from its answer."""
    warm = replace(plain(), temperature=np.full(plain().time.size, 300.0))
    assert examine(warm, RATIO).sentences and examine(warm, RATIO).contradictions == ()
    slow = replace(plain(), joint_position=late(plain().joint_position, 10))
    found = examine(slow, RATIO)
    assert any("shifted in time" in text for text in found.sentences) and found.contradictions == ()
    measured = {delay.signal: delay for delay in found.delays}
    assert measured["joint_position"].sure and measured["joint_position"].low < 0.01 < measured["joint_position"].high


@pytest.mark.parametrize("ratio", [99.0, 101.0, 160.0])
def test_the_ratio_that_the_positions_have_is_named(ratio: float) -> None:
    """1e-3 of it is what the torsion may add; here the gauge takes the torsion out, 1e-5 is left."""
    (sentence,) = check_signals(plain(), ratio)
    found = re.search(r"turns ([\d.]+) per joint turn, the model says ([\d.]+)", sentence)
    assert found and float(found[1]) == pytest.approx(RATIO, rel=1e-4) and float(found[2]) == ratio
    assert check_signals(plain(), RATIO * 1.0005) == ()


def test_a_joint_that_only_its_neighbours_push_says_nothing_of_signs() -> None:
    small = with_noise(simulate(tones=((0.02, 0.4), (0.01, 1.3), (0.004, 2.1))))
    assert np.ptp(small.joint_position) < 0.1
    assert check_signals(replace(small, gauge_torque=-small.gauge_torque), RATIO) == ()


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


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed > 30413)) for seed in range(30410, 30422)]
)
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
