"""Delays between signals that are known are found; slow rows and their regressions against plain least squares."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import PERIOD, RATIO, Changes, Joint, simulate, with_noise
from scipy.signal import lfilter

from hd_control.lab.signals.delays import (
    LONGEST_S,
    MOTION,
    SMALLEST,
    KnownLinks,
    MeasuredDelay,
    Shift,
    SlowRows,
    best_shift,
    carried,
    delay_sentences,
    in_time,
    measured_delays,
    regress,
)
from hd_control.lab.signals.filters import EDGE_S
from hd_control.lab.signals.joint_signals import JointSignals


@lru_cache(maxsize=1)
def signals() -> JointSignals:
    """A clean joint with little noise."""
    return with_noise(simulate())


def shifted(column: np.ndarray, seconds: float) -> np.ndarray:
    """The column `seconds` later by Fourier's shift, away from the ends exact for what lies below half of the rate."""
    n = column.size
    ramp = np.linspace(column[0], column[-1], n)
    spectrum = np.fft.rfft(column - ramp) * np.exp(-2j * np.pi * np.fft.rfftfreq(n, PERIOD) * seconds)
    return np.fft.irfft(spectrum, n) + ramp - seconds / PERIOD * (ramp[1] - ramp[0])


def tones(frequencies: tuple[float, ...] = (0.4, 3.0)) -> JointSignals:
    """A motor that moves in sines, rad before the gear; its derivatives are known."""
    time = np.arange(12_000) * PERIOD
    angle = RATIO * sum(np.sin(2.0 * np.pi * f * time) / f for f in frequencies)
    return JointSignals("joint", time, PERIOD, np.ones(time.size, bool), angle, motor_torque=np.sin(20.0 * time))


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("advance", [0.0, 0.0137])
def test_rows_are_derivatives_read_later(derivative: int, advance: float) -> None:
    """d/dt^n of sin(w t) / f at t + advance; the ends reflect what they do not know."""
    rows = SlowRows(tones(), RATIO)
    time = np.arange(12_000)[:: rows.band.step] * PERIOD + advance
    omega = 2.0 * np.pi * np.array([0.4, 3.0])[:, None]
    exact = (np.sin(omega * time + 0.5 * np.pi * derivative) * omega**derivative * 2.0 * np.pi / omega).sum(axis=0)
    found = rows.rows("motor_shaft_position", derivative, advance)
    error = np.abs(found - exact)[rows.usable]
    assert error.max() < 2e-3 * np.abs(exact).max()


def test_a_torque_counts_as_held_over_its_tick() -> None:
    rows = SlowRows(tones(), RATIO)
    time = np.arange(12_000)[:: rows.band.step] * PERIOD
    x = 20.0 * PERIOD / 2.0  # the mean over a tick is half a tick late
    np.testing.assert_allclose(rows.rows("motor_torque")[rows.usable], np.sin(20.0 * time - x)[rows.usable], atol=2e-3)


def test_friction_is_the_direction_and_the_speed() -> None:
    """At 6 rad/s the direction is +-1 but for the passages; filtered as everything else it rings at its steps only."""
    rows = SlowRows(tones((0.4,)), RATIO)
    direction, speed = rows.friction()
    fast = rows.usable & (np.abs(speed) > 0.9 * np.abs(speed).max())
    np.testing.assert_allclose(direction[fast], np.sign(speed)[fast], atol=0.05)
    np.testing.assert_array_equal(speed, rows.rows("motor_shaft_position", 1))
    acceleration, sine, cosine, one = rows.link()
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0)
    assert (one == 1.0).all() and np.array_equal(acceleration, rows.rows("motor_shaft_position", 2))


def test_rows_near_gaps_and_ends_are_not_usable() -> None:
    whole = tones()
    valid = np.ones(12_000, bool)
    valid[5000:5010] = False
    rows = SlowRows(replace(whole, valid=valid), RATIO)
    time = np.arange(12_000)[:: rows.band.step] * PERIOD
    away = rows.band.support_s + rows.band.step * PERIOD
    usable = time[rows.usable]
    near = rows.band.support_s - PERIOD
    assert not ((usable > 5.0 - near) & (usable < 5.009 + near)).any()
    assert usable.min() == pytest.approx(EDGE_S + rows.band.support_s, abs=away)
    lost = (~rows.usable).sum() * rows.band.step * PERIOD
    assert lost == pytest.approx(0.01 + 2.0 * EDGE_S + 4.0 * rows.band.support_s, abs=0.1), "and no more than needed"


def test_regressions_are_least_squares(rng: np.random.Generator) -> None:
    """Columns of very different sizes; white noise, so that the errors are those of the textbook."""
    usable = rng.random(4000) < 0.7
    columns = [rng.standard_normal(4000) * size for size in (1.0, 1e-5, 1e4)]
    true = np.array([2.0, -3e4, 1e-4])
    left = np.column_stack(columns) @ true + 0.5 * rng.standard_normal(4000)
    fit = regress(left, columns, usable)
    a, y = np.column_stack(columns)[usable], left[usable]
    expected, squares, _, _ = np.linalg.lstsq(a / np.abs(a).max(axis=0), y, rcond=None)
    np.testing.assert_allclose(fit.coefficients, expected / np.abs(a).max(axis=0), rtol=1e-9)
    covariance = float(squares[0]) / (y.size - 3) * np.linalg.inv(a.T @ a)
    # The rows are independent: their correlation adds at most a per cent or two by chance.
    np.testing.assert_allclose([fit.error(i) for i in range(3)], np.sqrt(np.diag(covariance)), rtol=0.03)
    weights = np.array([1.0, 1e-4, 0.0])
    assert fit.t(1) == pytest.approx(fit.coefficients[1] / fit.error(1))
    expected_t = weights @ fit.coefficients / np.sqrt(weights @ covariance @ weights)
    assert fit.t_of(weights) == pytest.approx(expected_t, rel=0.03)
    assert fit.rest == pytest.approx(np.sqrt(squares[0] / y.size)) and fit.spread == pytest.approx(y.std())


@pytest.mark.parametrize("memory", [0.0, 0.8, 0.95])
def test_errors_allow_for_residuals_that_hang_together(memory: float) -> None:
    """The mean of an AR(1) of n rows errs by sqrt((1 + r) / (1 - r) / n): 200 trials against the stated error."""
    random, rows, trials = np.random.default_rng(3), 1500, 200
    noise = lfilter([1.0], [1.0, -memory], random.standard_normal((trials, rows + 200)), axis=1)[:, 200:]
    fits = [regress(row, [np.ones(rows)], np.ones(rows, bool)) for row in noise]
    stated = float(np.mean([fit.error(0) for fit in fits]))
    seen = float(np.std([fit.coefficients[0] for fit in fits]))
    # 200 trials know a deviation within 5 %; the sum of correlations stops at 0.05 and misses up to a tenth.
    assert stated == pytest.approx(seen, rel=0.2)


def test_columns_that_say_the_same_get_no_number_by_chance(rng: np.random.Generator) -> None:
    x = rng.standard_normal(500)
    fit = regress(2.0 * x + 0.1 * rng.standard_normal(500), [x, x * (1.0 + 1e-12)], np.ones(500, bool))
    assert abs(fit.t(0)) < 1.0 and abs(fit.t(1)) < 1.0
    assert fit.t_of(np.ones(2)) > 100.0, "their sum is known"


@pytest.mark.parametrize("milliseconds", [-40.0, -3.3, 0.0, 0.25, 7.0, 61.8])
def test_the_best_shift_is_the_delay_of_the_joint_angle(milliseconds: float) -> None:
    """Resolution of the search is 2 ms; the parabola finds a twentieth of a sample."""
    late = replace(signals(), joint_position=shifted(signals().joint_position, 1e-3 * milliseconds))
    rows = SlowRows(late, RATIO)
    columns = [rows.rows("gauge_torque"), np.ones(rows.usable.size)]
    shift = best_shift(rows, "joint_position", columns, minus=rows.rows("motor_shaft_position"))
    assert shift.seconds == pytest.approx(1e-3 * milliseconds, abs=5e-5)
    assert shift.inside and shift.error < 1e-4
    assert shift.counts(PERIOD) == (abs(milliseconds) > SMALLEST)
    if shift.counts(PERIOD):
        assert shift.gain < 0.05, "without the shift far more is left"


def test_a_shift_beyond_the_search_is_no_answer() -> None:
    late = replace(signals(), joint_position=shifted(signals().joint_position, 1.5 * LONGEST_S))
    rows = SlowRows(late, RATIO)
    columns = [rows.rows("gauge_torque"), np.ones(rows.usable.size)]
    shift = best_shift(rows, "joint_position", columns, minus=rows.rows("motor_shaft_position"))
    assert not shift.inside and not shift.counts(PERIOD)


LITTLE_FRICTION = Joint(coulomb=1.0)
"""Where a joint sticks, its torque leads the motion, and delays of torques come out too early: see below."""


@pytest.mark.parametrize(
    ("name", "samples", "error"), [("joint_position", 4, 0.1), ("joint_position", -9, 0.1), ("gauge_torque", 25, 0.5)]
)
def test_the_sentence_names_signal_size_and_sense(name: str, samples: int, error: float) -> None:
    whole = with_noise(simulate(joint=LITTLE_FRICTION))
    late = replace(whole, **{name: shifted(getattr(whole, name), samples * PERIOD)})
    (sentence,) = delay_sentences(SlowRows(late, RATIO))
    found = re.search(rf"{name} ([\d.]+) ms \(([\d.]+) samples\) (late|early)", sentence)
    assert found, sentence
    sign = 1.0 if found[3] == "late" else -1.0
    assert sign * float(found[2]) == pytest.approx(samples, abs=error)
    assert float(found[1]) == pytest.approx(float(found[2]) * 1e3 * PERIOD, rel=0.02)


@pytest.mark.parametrize(("coulomb", "error"), [(0.0, 2e-5), (1.0, 6e-4)])
def test_a_drive_that_answers_late_is_said_with_its_delay(coulomb: float, error: float) -> None:
    """Without friction the balance is exact; with it the direction is smoothed, which costs half a sample."""
    joint = Joint(coulomb=coulomb)
    in_time, late = (SlowRows(with_noise(simulate(Changes(late=n), joint)), RATIO) for n in (0, 8))
    assert delay_sentences(in_time) == []
    one = np.ones(late.usable.size)
    columns = [late.rows("gauge_torque"), late.rows(late.position, 2), *late.friction(), one]
    assert best_shift(late, "motor_torque", columns).seconds == pytest.approx(-8e-3, abs=error)
    (sentence,) = delay_sentences(late)
    assert re.search(r"motor_torque 8\.?\d* ms \(8\.\d samples\) early", sentence), sentence


def test_a_joint_that_sticks_is_not_called_late() -> None:
    """Its torque rises before it moves: the best shift is several samples, but it explains hardly more than none."""
    rows = SlowRows(signals(), RATIO)
    assert delay_sentences(rows) == []
    columns = [rows.rows("gauge_torque"), rows.rows(rows.position, 2), *rows.friction(), np.ones(rows.usable.size)]
    shift = best_shift(rows, "motor_torque", columns)
    assert shift.long(PERIOD) and not shift.counts(PERIOD)


def test_little_motion_or_a_single_sine_says_nothing_of_delays() -> None:
    """On one sine a delay and friction are the same: the spectra of speed and acceleration must have several lines."""
    for tone in (((0.5, 0.6),), ((0.02, 0.3), (0.01, 1.1), (0.005, 2.3))):
        moved = with_noise(simulate(tones=tone))
        late = replace(moved, joint_position=shifted(moved.joint_position, 0.02))
        assert delay_sentences(SlowRows(late, RATIO)) == []
    late = SlowRows(replace(signals(), joint_position=shifted(signals().joint_position, 0.02)), RATIO)
    assert len(delay_sentences(late)) == 1


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        ({}, True),
        ({"seconds": 1.9e-3}, False),
        ({"error": 0.4e-3}, False),
        ({"inside": False}, False),
        ({"gain": 0.9}, False),
        ({"rest": 0.2}, False),
    ],
)
def test_a_shift_counts_if_it_is_long_sure_inside_and_explains(change: dict[str, float], counts: bool) -> None:
    shift = replace(Shift("x", 3e-3, 1e-4, 0.3, 0.05, True), **change)
    assert shift.counts(PERIOD) == counts
    assert replace(shift, seconds=-shift.seconds).counts(PERIOD) == counts
    assert Shift("x", -3.1e-3, 0.0, 0.0, 0.0, True).words(PERIOD) == "x 3.1 ms (3.1 samples) early"


def test_every_signal_has_its_measured_delay_with_an_interval() -> None:
    late = replace(signals(), joint_position=shifted(signals().joint_position, 7e-3))
    found = {delay.signal: delay for delay in measured_delays(SlowRows(late, RATIO))}
    assert set(found) == {"joint_position", "motor_torque", "gauge_torque"}
    joint = found["joint_position"]
    assert joint.against == "motor_shaft_position" and joint.determined and joint.sure
    assert joint.low < 7e-3 < joint.high and joint.high - joint.low < 1e-3
    assert not found["gauge_torque"].sure and found["gauge_torque"].against == MOTION


def test_a_delay_that_is_not_determined_says_why() -> None:
    little = SlowRows(with_noise(simulate(tones=((0.02, 0.3), (0.01, 1.1), (0.005, 2.3)))), RATIO)
    assert all(not d.determined and "rad only" in d.why_not for d in measured_delays(little))
    one_sine = SlowRows(with_noise(simulate(tones=((0.5, 0.6),))), RATIO)
    assert all("frequencies only" in d.why_not for d in measured_delays(one_sine))
    far = replace(signals(), joint_position=shifted(signals().joint_position, 1.5 * LONGEST_S))
    found = {delay.signal: delay for delay in measured_delays(SlowRows(far, RATIO))}
    assert "no best shift within 100 ms" in found["joint_position"].why_not


def test_known_links_take_the_place_of_an_own_gravity() -> None:
    """A torque that follows another joint's angle: only a description knows it."""
    whole = replace(signals(), gauge_torque=None, motor_shaft_position=None)
    other = 30.0 * np.sin(1.3 * whole.time) + 10.0 * np.cos(0.4 * whole.time)
    moved = replace(whole, motor_torque=whole.motor_torque + other)
    (blind,) = measured_delays(SlowRows(moved, RATIO))
    known = measured_delays(SlowRows(moved, RATIO, KnownLinks(np.zeros(other.size), other)))
    assert not blind.determined and blind.why_not
    assert known[0].determined and abs(known[0].seconds) < 0.02


def test_a_stiff_spring_alone_does_not_need_a_gauge() -> None:
    """Without a gauge the torsion follows from the link: acceleration and gravity."""
    blind = replace(signals(), gauge_torque=None, joint_position=shifted(signals().joint_position, 5e-3))
    (sentence,) = delay_sentences(SlowRows(blind, RATIO))
    assert "joint_position 5" in sentence and "against motor_shaft_position" in sentence


def test_sure_delays_are_taken_out_and_unsure_ones_stay() -> None:
    gauge = MeasuredDelay("gauge_torque", MOTION, 0.05, 0.048, 0.052, True, True)
    motor = MeasuredDelay("motor_torque", MOTION, 0.02, 0.018, 0.022, True, True)
    joint = MeasuredDelay("joint_position", "motor_shaft_position", -7e-3, -7.1e-3, -6.9e-3, True, True)
    assert carried([gauge, joint]) == (
        {"joint_position": -7e-3, "gauge_torque": 0.05},
        ("joint_position taken 7 ms later, as measured", "gauge_torque taken 50 ms earlier, as measured"),
    )
    assert carried([gauge, motor]) == ({}, ()), "perhaps only one of two torques is late"
    assert carried([motor])[0] == {"motor_torque": 0.02}
    assert carried([replace(motor, seconds=-0.02)]) == ({}, ()), "a drive that answers late is an effect"
    assert carried([replace(gauge, sure=False)]) == ({}, ())


def test_a_signal_without_its_delay_is_the_signal() -> None:
    whole = signals()
    late = replace(whole, gauge_torque=shifted(whole.gauge_torque, 7.3e-3))
    found = in_time(late, {"gauge_torque": 7.3e-3})
    inside = slice(1000, -1000)
    noise = np.std(np.diff(whole.gauge_torque)) / np.sqrt(2.0)
    assert np.std((found.gauge_torque - whole.gauge_torque)[inside]) < noise
    assert np.isnan(found.gauge_torque[-7:]).all() and not found.valid[-7:].any() and found.valid[:-8].all()
    assert found.joint_position is whole.joint_position
