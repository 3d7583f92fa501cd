"""States of a drive from its signals: noise that is known, reversals, masks of what is usable, counts of encoders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import PERIOD, RATIO
from plain_joint import signals

from hd_control.lab.balances.states import (
    MOST_NOISY,
    PRESLIDING_SPEED,
    PRESLIDING_TRAVEL,
    count_tone,
    derive,
    drive_states,
    few_counts,
    noise_density,
    noisy_rows,
    quantum,
    reversals,
    since_reversal,
)
from hd_control.lab.signals.filters import EDGE_S, Band, Spectral
from hd_control.lab.signals.joint_signals import JointSignals


def derived(recorded: JointSignals):  # type: ignore[no-untyped-def] # a helper of this file
    """(derived, states) of a recording."""
    spectral = Spectral(recorded.time.size, recorded.period)
    found = derive(recorded, RATIO, spectral)
    return found, drive_states(recorded, RATIO, spectral, found)


@pytest.mark.parametrize("sigma", [1e-6, 1e-3])
def test_white_noise_on_a_motion_is_known_to_three_per_cent(sigma: float) -> None:
    """The median of 4000 bins of a chi-square with two degrees errs by 1 / (2 ln 2 sqrt(n)) of the power, 1.2 %."""
    time, random = np.arange(20_000) * PERIOD, np.random.default_rng(1)
    motion = np.sin(2.0 * time) + 0.1 * np.sin(60.0 * time) + time
    found = noise_density(motion + sigma * random.standard_normal(time.size), PERIOD)
    assert found == pytest.approx(sigma, rel=0.03)


def test_a_line_in_the_spectrum_is_no_noise() -> None:
    time, random = np.arange(20_000) * PERIOD, np.random.default_rng(1)
    noise = 1e-3 * random.standard_normal(time.size)
    with_line = noise + 0.02 * np.sin(2.0 * np.pi * 401.0 * time)
    assert noise_density(with_line, PERIOD) == pytest.approx(noise_density(noise, PERIOD), rel=0.03)


def test_fast_counts_are_noise_of_their_twelfth() -> None:
    """An angle that crosses many counts per sample errs evenly within one: standard deviation count / sqrt(12)."""
    time, count = np.arange(20_000) * PERIOD, 1e-4
    angle = count * np.round((3.0 * np.sin(1.3 * time) + 0.7 * np.sin(4.1 * time)) / count)
    assert noise_density(angle, PERIOD) == pytest.approx(count / np.sqrt(12.0), rel=0.05)


def test_reversals_are_the_passages_of_zero_and_noise_makes_none() -> None:
    time = np.arange(10_000) * PERIOD
    speed = np.cos(2.0 * np.pi * 0.7 * time)
    turns = (np.arange(14) + 0.5) / 1.4  # zeros of the cosine
    np.testing.assert_allclose(reversals(speed, 0.05) * PERIOD, turns, atol=0.51 * PERIOD)
    noisy = speed + 0.03 * np.random.default_rng(0).standard_normal(time.size)
    assert reversals(noisy, 0.15).size == 14
    assert reversals(np.abs(speed), 0.05).size == 0, "a stop is no change of direction"
    for sign in (-1.0, 1.0):  # rest after a motion, with noise of both signs
        stop = np.where(time < 5.0, sign, 0.0) + 0.03 * np.random.default_rng(0).standard_normal(time.size)
        assert reversals(stop, 0.15).size == 0
    assert reversals(np.zeros(100), 0.05).size == 0


def test_travel_and_time_count_from_the_last_reversal() -> None:
    """A triangle of 1 rad/s that turns every second."""
    time = np.arange(4000) * PERIOD
    position = np.abs(np.mod(time + 1.0, 2.0) - 1.0)
    velocity = np.where(np.mod(time, 2.0) < 1.0, 1.0, -1.0)
    travel, age = since_reversal(position, velocity, PERIOD, 0.5)
    inside = np.mod(time, 1.0) < 0.9985  # the turn lies on the last sample of a second or on the next one
    np.testing.assert_allclose(age[inside], np.mod(time, 1.0)[inside], atol=1.01 * PERIOD)
    np.testing.assert_allclose(travel[inside], np.mod(time, 1.0)[inside], atol=2.0 * PERIOD)


def test_velocities_are_those_of_the_motion() -> None:
    """Light filters: a sine of 2.5 Hz passes whole; at stops of the dry friction the speed has a corner."""
    clean = signals(noisy=False)
    found, states = derived(clean)
    inside = slice(600, -600)
    for velocity, position in (
        (found.motor_velocity, clean.motor_shaft_position / RATIO),
        (found.joint_velocity, clean.joint_position),
    ):
        exact = np.gradient(position, PERIOD)
        assert np.sqrt(np.mean((velocity - exact)[inside] ** 2)) < 4e-3 * np.abs(exact).max()
    # At a stop the acceleration jumps by 7 rad/s^2: a corner of 7 t^2 / 2 within the filter's 5 ms.
    np.testing.assert_allclose(found.joint_position[inside], clean.joint_position[inside], atol=1e-4)
    # The torque rings with the resonance at stops; its rate is that of the torque as the light filter sees it.
    rate = np.gradient(states.joint_torque, PERIOD)
    assert np.sqrt(np.mean((states.joint_torque_rate - rate)[inside] ** 2)) < 0.01 * rate.std()
    assert np.sqrt(np.mean((states.joint_torque - clean.gauge_torque)[inside] ** 2)) < 0.01 * clean.gauge_torque.std()


def test_sliding_is_beyond_speed_and_travel_and_direction_is_its_sign() -> None:
    found, _ = derived(signals())
    assert found.speed_threshold == PRESLIDING_SPEED, "the noise of a good encoder does not raise it"
    fast, far = np.abs(found.motor_velocity) >= PRESLIDING_SPEED, found.reversal_travel >= PRESLIDING_TRAVEL
    np.testing.assert_array_equal(found.sliding, fast & far)
    assert 0.5 < found.sliding.mean() < 0.95
    moving = np.abs(found.motor_velocity) >= 0.1 * PRESLIDING_SPEED
    np.testing.assert_array_equal(found.direction, np.where(moving, np.sign(found.motor_velocity), 0.0))


def test_a_coarse_encoder_raises_the_threshold_as_its_noise_says() -> None:
    """At least six standard deviations of the filtered speed; its bound takes all noise for that at 0.7 of the zero."""
    coarse = replace(signals(), motor_shaft_position=signals().motor_shaft_position
                     + 0.05 * np.random.default_rng(2).standard_normal(signals().time.size))  # fmt: skip
    found, _ = derived(coarse)
    rest = found.motor_velocity - derived(signals())[0].motor_velocity
    assert found.speed_threshold > PRESLIDING_SPEED
    assert 6.0 < found.speed_threshold / rest[600:-600].std() < 9.0


def test_gaps_and_ends_are_not_usable_and_gaps_are_bridged() -> None:
    valid = np.ones(signals().time.size, bool)
    gauge = signals().gauge_torque.copy()
    gauge[5000:5020], valid[9000:9005] = np.nan, False
    found, states = derived(replace(signals(), gauge_torque=gauge, valid=valid))
    edge = round(EDGE_S / PERIOD)
    lost = np.flatnonzero(~found.usable)
    expected = [*range(edge), *range(5000, 5020), *range(9000, 9005), *range(valid.size - edge, valid.size)]
    assert lost.tolist() == expected
    assert np.isfinite(found.filled["gauge_torque"]).all() and np.isfinite(states.joint_torque).all()


def test_an_angle_that_is_not_recorded_is_replaced_by_the_other() -> None:
    only_joint, _ = derived(replace(signals(), motor_shaft_position=None))
    np.testing.assert_array_equal(only_joint.filled["motor_position"], signals().joint_position)
    only_motor, states = derived(replace(signals(), joint_position=None))
    np.testing.assert_array_equal(only_motor.filled["joint_position"], signals().motor_shaft_position / RATIO)
    np.testing.assert_allclose(states.motor_shaft_position, signals().motor_shaft_position, rtol=1e-12)
    with pytest.raises(ValueError, match="neither motor nor joint position"):
        derived(replace(signals(), motor_shaft_position=None, joint_position=None))


def test_what_is_not_recorded_is_no_number() -> None:
    found, states = derived(replace(signals(), gauge_torque=None, motor_torque=None))
    for name in ("gauge_torque", "joint_torque", "joint_torque_rate", "motor_torque", "temperature"):
        assert np.isnan(getattr(states, name)).all(), name
    assert states.torque_scale == 1.0 and np.isnan(found.gauge_torque).all()
    assert np.isnan(states.link_inertia_torque).all() and np.isnan(states.link_bias_torque).all()


def test_the_motor_torque_counts_from_its_stamp_on_and_the_scale_is_that_of_the_gauge() -> None:
    """Held over the tick: half a period late. 98 % of the gauge's readings are below the scale."""
    _, states = derived(signals())
    u, inside = signals().motor_torque, slice(600, -600)
    middle = 0.5 * (u + np.concatenate([u[:1], u[:-1]]))
    late = np.sqrt(np.mean((states.motor_torque - middle)[inside] ** 2))
    assert late < 0.3 * np.sqrt(np.mean((states.motor_torque - u)[inside] ** 2))
    used = np.abs(states.joint_torque[600:-600])
    assert np.mean(used <= states.torque_scale) == pytest.approx(0.98, abs=0.005)


def test_the_count_is_found_and_noise_has_none(rng: np.random.Generator) -> None:
    angle = np.cumsum(rng.standard_normal(5000)) * 1e-4
    assert quantum(3e-5 * np.round(angle / 3e-5)) == pytest.approx(3e-5)
    assert quantum(angle) == 0.0 and quantum(np.ones(10)) == 0.0


def test_slow_motion_and_its_beats_are_tones() -> None:
    count = 1e-4
    speed = np.array([0.0, 0.005, 0.02, 0.05, 0.1, 0.102, 0.15])  # rad/s: counts per sample 0 to 1.5
    expected = [True, True, False, False, True, True, False]
    assert count_tone(speed, count, PERIOD, 60.0).tolist() == expected
    assert count_tone(speed, count, PERIOD, 60.0, (1, 2)).tolist() == [*expected[:3], True, *expected[4:6], True]
    assert not count_tone(speed, 0.0, PERIOD, 60.0).any()


def test_motion_over_a_few_counts_repeats_their_error() -> None:
    time, count = np.arange(4000) * PERIOD, 1e-5
    small, wide = (size * count * np.sin(2.0 * np.pi * 20.0 * time) for size in (3.0, 8.0))
    assert few_counts(small, count, PERIOD).all() and not few_counts(wide, count, PERIOD).any()
    assert not few_counts(small, 0.0, PERIOD).any()


def test_rows_are_noisy_where_the_counts_are_a_tone_of_the_band() -> None:
    """Of a joint whose encoder counts; one that is much finer than the other is no matter, and noise has no counts."""
    count, band = 4e-5, Band(38.0, 60.0, 8)
    coarse = replace(signals(), motor_shaft_position=RATIO * count
                     * np.round(signals(noisy=False).motor_shaft_position / RATIO / count))  # fmt: skip
    found, _ = derived(coarse)
    every, angles = np.ones(-(-coarse.time.size // 8), bool), {"motor_position": (1,)}
    noisy = noisy_rows(found, PERIOD, band, every, angles)
    slow = np.abs(found.motor_velocity[::8]) < count * 60.0
    assert noisy[slow].all() and 0.0 < noisy.mean() < MOST_NOISY
    both, fine = {"motor_position": (1,), "joint_position": (1,)}, 0.1 * count
    finer = replace(coarse, joint_position=fine * np.round(signals(noisy=False).joint_position / fine))
    np.testing.assert_array_equal(noisy_rows(derived(finer)[0], PERIOD, band, every, both), noisy)
    assert not noisy_rows(derived(signals())[0], PERIOD, band, every, both).any()


def test_an_angle_that_would_take_most_rows_is_let_in() -> None:
    """Harmonics 1 to 8 of the counts cover everything: then nothing is left out."""
    count, band = 4e-5, Band(38.0, 60.0, 8)
    coarse = replace(signals(), motor_shaft_position=RATIO * count
                     * np.round(signals(noisy=False).motor_shaft_position / RATIO / count))  # fmt: skip
    found, _ = derived(coarse)
    every = np.ones(-(-coarse.time.size // 8), bool)
    assert not noisy_rows(found, PERIOD, band, every, {"motor_position": tuple(range(1, 9))}).any()
