"""Coverage of a recording: its numbers are those of the motion, and each shortfall appears exactly when it is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import PERIOD, RATIO, Changes
from plain_joint import equations, known, signals

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.library import effect_named, library
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.coverage import Coverage, coverage, shortfalls, unsupported
from hd_control.lab.signals.filters import EDGE_S
from hd_control.lab.signals.joint_signals import JointSignals

EVERYTHING = (MOTOR, TRANSMISSION, LINK)
RATED = 100.0
GOOD = Coverage(
    duration=60.0,
    moving=45.0,
    slow_speed=0.02,
    fast_speed=0.8,
    both_directions=True,
    reversals=40,
    torque_low=-30.0,
    torque_high=40.0,
    joint_range=2.0,
    motor_turns=30.0,
    temperature_span=8.0,
    acceleration_snr={MOTOR: 1000.0, TRANSMISSION: np.inf, LINK: 1000.0},
    saturated=0.0,
    repetition=0.5,
    speed_variety=9.0,
    compliance_error=0.002,
)


def test_the_numbers_are_those_of_the_motion() -> None:
    """Against the clean signals: quantiles and ranges of what was moved, from edge to edge."""
    found, clean = coverage(equations()), signals(noisy=False)
    edge = round(EDGE_S / PERIOD)
    inside = slice(edge, -edge)
    seconds = clean.time.size * PERIOD
    assert found.duration == pytest.approx(seconds - 2.0 * EDGE_S, abs=0.01)
    speed = np.abs(np.gradient(clean.motor_shaft_position / RATIO, PERIOD)[inside])
    sliding = speed > 6e-3
    # The first 1.5 mrad after each of fifty reversals do not count.
    assert 0.92 < found.moving / (sliding.sum() * PERIOD) < 1.0
    slow, fast = np.quantile(speed[equations().derived.sliding[inside]], [0.05, 0.99])
    assert (found.slow_speed, found.fast_speed) == pytest.approx((slow, fast), rel=0.03)
    assert found.speed_decades == pytest.approx(np.log10(found.fast_speed / found.slow_speed))
    low, high = np.quantile(clean.gauge_torque[inside], [0.02, 0.98])
    assert (found.torque_low, found.torque_high) == pytest.approx((low, high), abs=0.1)
    assert found.joint_range == pytest.approx(np.ptp(clean.joint_position[inside]), rel=1e-3)
    assert found.motor_turns == pytest.approx(np.ptp(clean.motor_shaft_position[inside]) / (2 * np.pi), rel=1e-3)
    directions = np.sign(np.gradient(clean.motor_shaft_position, PERIOD))[speed_rows(clean)]
    assert found.reversals == pytest.approx(np.count_nonzero(np.diff(directions)), abs=2)
    assert found.both_directions and found.temperature_span == 0.0 and found.too_short == ()
    assert found.acceleration_snr == {name: c.snr for name, c in equations().channels.items()}


def speed_rows(clean: JointSignals) -> np.ndarray:
    """Rows at which the rotor moves for sure."""
    return np.abs(np.gradient(clean.motor_shaft_position / RATIO, PERIOD)) > 6e-3


def test_a_warm_joint_has_a_temperature_span() -> None:
    there = equations(Changes(temperature=_warming))
    assert coverage(there).temperature_span == pytest.approx(10.0 * (30.0 - 2.0 * EDGE_S) / 30.0, rel=1e-3)


def _warming(t: float) -> float:
    return 25.0 + t / 3.0


def test_one_way_motion_is_seen() -> None:
    """The same motion laid over a ramp that is faster."""
    one_way = replace(
        signals(),
        motor_shaft_position=signals().motor_shaft_position + RATIO * signals().time,
        joint_position=signals().joint_position + signals().time,
    )
    found = coverage(build_equations(one_way, known(), None))
    assert not found.both_directions and found.reversals == 0


def test_saturation_is_the_share_at_the_largest_torque() -> None:
    limit = float(np.quantile(np.abs(signals().motor_torque), 0.9))
    clipped = replace(signals(), motor_torque=np.clip(signals().motor_torque, -limit, limit))
    found = coverage(build_equations(clipped, known(), None))
    assert found.saturated == pytest.approx(0.1, abs=0.01)
    assert coverage(equations()).saturated < 0.01


@pytest.mark.parametrize(("period_s", "repeats"), [(2.5, True), (None, False)])
def test_motion_that_repeats_is_seen(period_s: float | None, repeats: bool) -> None:
    """A triangle again and again against the general motion; its speeds are two, those are many."""
    if period_s is None:
        found = coverage(equations())
    else:
        time = signals().time
        phase = time / period_s
        angle = 0.5 * np.abs(2.0 * (phase - np.floor(phase + 0.5)))
        same = replace(signals(), motor_shaft_position=RATIO * angle, joint_position=angle)
        found = coverage(build_equations(same, known(), None))
    assert (found.repetition > 0.9) == repeats
    assert (found.speed_variety < 2.0) == repeats


def test_variety_counts_quarter_decades() -> None:
    """Speeds spread evenly over the logarithm from 0.01 to 1 rad/s: eight quarters."""
    time = np.arange(60_000) * PERIOD
    speed = 10.0 ** (-2.0 + 2.0 * (np.arange(time.size) / time.size))
    angle = np.cumsum(speed) * PERIOD
    signal = JointSignals("j", time, PERIOD, np.ones(time.size, bool), RATIO * angle, angle, np.sin(time), np.sin(time))
    found = coverage(build_equations(signal, known(), None))
    assert found.speed_variety == pytest.approx(8.0, rel=0.05)
    assert found.speed_decades == pytest.approx(np.log10(10.0**-0.02 / 10.0**-1.9), abs=0.05)


def test_a_good_recording_has_no_shortfall() -> None:
    assert shortfalls(GOOD) == []
    for effect in library().values():
        assert unsupported(effect, GOOD, RATED) is None, effect.name


@pytest.mark.parametrize(
    ("change", "channels", "says"),
    [
        ({"duration": 11.9}, EVERYTHING, "only 11.9 s of usable recording"),
        ({"moving": 5.9}, EVERYTHING, "5.9 s of them in motion"),
        ({"too_short": (MOTOR,)}, (MOTOR,), "too little sliding motion for the motor torque balance"),
        ({"saturated": 0.031}, EVERYTHING, "at its limit for 3 % of the time"),
        ({"repetition": 0.91, "speed_variety": 5.9}, EVERYTHING, "the same few moves again and again"),
        ({"reversals": 4}, (MOTOR, LINK), "4 changes of direction"),
        ({"both_directions": False}, (MOTOR, LINK), "motion mostly one way"),
        ({"slow_speed": 0.05}, (MOTOR, LINK), "1.20 decades, 1.3 needed"),
        ({"acceleration_snr": {MOTOR: 9.9, TRANSMISSION: np.inf, LINK: 11.0}}, (MOTOR,), "acceleration 9.9 times"),
        ({"acceleration_snr": {MOTOR: 11.0, TRANSMISSION: np.inf, LINK: 9.9}}, (LINK,), "acceleration 9.9 times"),
        ({"compliance_error": 0.021}, (TRANSMISSION,), "stiffness within 2 % only"),
    ],
)
def test_each_shortfall_appears_alone_when_its_range_is_missing(
    change: dict[str, object], channels: tuple[str, ...], says: str
) -> None:
    (found,) = shortfalls(replace(GOOD, **change))  # type: ignore[arg-type] # fields of the dataclass
    assert found.channels == channels and says in found.what
    assert found.purpose and found.how, "every refusal carries the experiment that would decide"


@pytest.mark.parametrize(
    "change",
    [
        {"duration": 12.0},
        {"moving": 6.0},
        {"saturated": 0.03},
        {"repetition": 0.99},
        {"repetition": 0.9, "speed_variety": 1.0},
        {"reversals": 5},
        {"slow_speed": 0.04},
        {"acceleration_snr": {MOTOR: 10.0, TRANSMISSION: np.inf, LINK: 10.0}},
        {"acceleration_snr": {TRANSMISSION: np.inf}},
        {"acceleration_snr": {MOTOR: 11.0}, "compliance_error": 1.0},
        {"compliance_error": 0.02},
    ],
)
def test_just_enough_is_enough(change: dict[str, object]) -> None:
    """Also repetition with many speeds, and a stiffness that no channel asks for."""
    assert shortfalls(replace(GOOD, **change)) == []  # type: ignore[arg-type] # fields of the dataclass


def test_the_most_important_comes_first_and_all_are_said() -> None:
    poor = replace(GOOD, duration=5.0, saturated=0.5, reversals=0, slow_speed=0.5, compliance_error=1.0)
    found = shortfalls(poor)
    assert [f.purpose for f in found] == [
        "enough data",
        "torques that the drive can follow",
        "friction against offsets and load",
        "the shape of friction over speed",
        "stiffness, lost motion and hysteresis",
    ]


@pytest.mark.parametrize(
    ("change", "refused", "says"),
    [
        (
            {"torque_low": -4.0, "torque_high": 5.0},
            {"nonlinear_stiffness", "torsional_hysteresis"},
            "joint torque from -4 to 5 N m only",
        ),
        (
            {"repetition": 0.7, "speed_variety": 5.0},
            {"nonlinear_stiffness", "torsional_hysteresis", "backlash"},
            "the same few loops",
        ),
        ({"torque_low": 1.0}, {"nonlinear_stiffness", "backlash"}, "does not change its sign"),
        ({"torque_high": -1.0}, {"nonlinear_stiffness", "backlash"}, "does not change its sign"),
        ({"temperature_span": 5.9}, {"temperature_friction"}, "temperature moves by 5.9 K only"),
        ({"motor_turns": 0.9}, {"kinematic_error", "motor_cogging", "gauge_ripple"}, "turns 0.90 times only"),
        ({"joint_range": 0.7}, {"joint_sensor_eccentricity"}, "over 40 degrees only"),
    ],
)
def test_effects_are_refused_exactly_where_the_recording_cannot_carry_them(
    change: dict[str, object], refused: set[str], says: str
) -> None:
    poor = replace(GOOD, **change)  # type: ignore[arg-type] # fields of the dataclass
    found = {name: unsupported(effect, poor, RATED) for name, effect in library().items()}
    assert {name for name, shortfall in found.items() if shortfall is not None} == refused
    for shortfall in found.values():
        assert shortfall is None or (says in shortfall.what and shortfall.how and shortfall.channels == ())
    assert shortfalls(poor) == [], "the balances themselves can be judged"


def test_without_a_rated_torque_no_load_is_too_small() -> None:
    small = replace(GOOD, torque_low=-0.1, torque_high=0.1)
    assert unsupported(effect_named("torsional_hysteresis"), small, None) is None
    assert unsupported(effect_named("torsional_hysteresis"), small, 10.0) is not None
