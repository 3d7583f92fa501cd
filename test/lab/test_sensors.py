"""Noise, counts, smoothing and repetition of sensors against signals whose noise is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from hd_control.lab.signals.joint_signals import Grain, JointSignals, grain_of, quantum
from hd_control.lab.signals.sensors import Segments, cut_off, difference_noise, noise_density_of, sensor_qualities
from hd_control.lab.signals.sources import held_from_measured

RATES = (100.0, 1000.0)
ANGLE, TORQUE = 2e-5, 0.3
"""Noise per sample, rad and N m."""


def motion(rate: float, seconds: float = 40.0) -> tuple[np.ndarray, np.ndarray]:
    """Time and an angle with reversals."""
    time = np.arange(round(seconds * rate)) / rate
    tones = (0.21, 0.53, 1.1, 2.4) if rate > 500.0 else (0.21, 0.53, 1.1)
    return time, sum(0.3 / f * np.sin(2.0 * np.pi * f * time + f) for f in tones)


def torque_of(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Friction that steps at every reversal, inertia, gravity."""
    velocity = np.gradient(angle, time)
    return 5.0 * np.sign(velocity) + 2.0 * velocity + 1.5 * np.gradient(velocity, time) + 20.0 * np.sin(angle)


def joint(rate: float, rng: np.random.Generator, **columns: np.ndarray) -> JointSignals:
    time, angle = motion(rate)
    noisy = {
        "joint_position": angle + ANGLE * rng.standard_normal(time.size),
        "motor_torque": torque_of(time, angle) + TORQUE * rng.standard_normal(time.size),
    }
    return JointSignals("joint", time, 1.0 / rate, np.ones(time.size, bool), **{**noisy, **columns})


@pytest.mark.parametrize("rate", RATES)
def test_white_noise_is_found_beside_motion_and_reversals(rate: float, rng: np.random.Generator) -> None:
    """Friction steps by 10 N m at some 200 reversals; the noise is 0.3 N m."""
    found = sensor_qualities(joint(rate, rng))
    assert set(found) == {"joint_position", "motor_torque"}
    assert found["joint_position"].noise == pytest.approx(ANGLE, rel=0.1)
    assert found["motor_torque"].noise == pytest.approx(TORQUE, rel=0.12)
    for quality in found.values():
        assert quality.density == pytest.approx(2.0 * quality.noise**2 / rate) and quality.rate == rate
        assert np.isinf(quality.smoothed_above) and quality.step == 0.0 and not quality.stutters
        assert quality.floor_density == quality.density
    assert found["motor_torque"].unit == "N m" and found["joint_position"].unit == "rad"


def test_what_a_servo_answers_to_its_encoder_is_no_noise(rng: np.random.Generator) -> None:
    """A torque of -2000 x filtered encoder noise is real; beside it the sensor's own noise is found."""
    time, angle = motion(1000.0)
    noise = ANGLE * rng.standard_normal(time.size)
    answer = -2e5 * lfilter([0.5, 0.5], [1.0, -0.2], np.roll(noise, 1))
    torque = torque_of(time, angle) + answer + TORQUE * rng.standard_normal(time.size)
    found = sensor_qualities(joint(1000.0, rng, joint_position=angle + noise, motor_torque=torque))
    assert answer.std() > 5.0 * TORQUE
    assert found["motor_torque"].noise == pytest.approx(TORQUE, rel=0.15)


def test_counts_are_read_and_are_a_floor(rng: np.random.Generator) -> None:
    time, angle = motion(1000.0)
    count = 1e-3
    counted = count * np.round(angle / count)
    found = sensor_qualities(joint(1000.0, rng, joint_position=counted))["joint_position"]
    assert found.step == pytest.approx(count)
    assert found.floor_density >= count**2 / 6.0 / 1000.0 * 0.999
    assert found.noise == pytest.approx(count / np.sqrt(12.0), rel=0.5), "slow counts are not quite white"


@pytest.mark.parametrize("cut", [8.0, 20.0])
def test_a_smoothed_torque_has_a_cut_off_and_no_noise(cut: float, rng: np.random.Generator) -> None:
    plain = joint(200.0, rng)
    smooth = sosfiltfilt(butter(3, cut, fs=200.0, output="sos"), plain.motor_torque)
    found = sensor_qualities(replace(plain, motor_torque=smooth))["motor_torque"]
    assert 0.4 * cut < found.smoothed_above < 1.5 * cut
    assert np.isnan(found.noise) and found.json()["noise"] is None and found.floor_density == 0.0
    assert json.loads(json.dumps(found.json()))["smoothed_above_hz"] == found.smoothed_above


def test_a_motion_that_ends_in_noise_is_no_filter(rng: np.random.Generator) -> None:
    """A chirp up to 20 Hz falls steeply above it, into the sensor's noise."""
    time = np.arange(40_000) / 1000.0
    chirp = 10.0 * np.sin(2.0 * np.pi * (0.3 * time + 0.25 * time**2)) + 0.01 * rng.standard_normal(time.size)
    found = sensor_qualities(JointSignals("j", time, 1e-3, np.ones(time.size, bool), gauge_torque=chirp))
    assert np.isinf(found["gauge_torque"].smoothed_above)
    assert found["gauge_torque"].noise == pytest.approx(0.01, rel=0.1)


def test_a_mean_over_each_tick_is_taken_back(rng: np.random.Generator) -> None:
    plain = joint(100.0, rng)
    mean = held_from_measured(np.asarray(plain.motor_torque))
    said = replace(plain, motor_torque=mean, grains={"motor_torque": Grain(averaged=True)})
    assert sensor_qualities(said)["motor_torque"].noise == pytest.approx(TORQUE, rel=0.12)
    assert sensor_qualities(said)["motor_torque"].averaged
    unsaid = sensor_qualities(replace(said, grains={}))["motor_torque"]
    assert unsaid.noise < 0.75 * TORQUE, "and unless it is said it would come out too low"


def test_a_sensor_that_is_read_more_often_than_it_measures(rng: np.random.Generator) -> None:
    time, angle = motion(1000.0)
    twice = np.repeat(angle[::2], 2)
    found = sensor_qualities(joint(1000.0, rng, joint_position=twice))["joint_position"]
    assert found.repeated == pytest.approx(0.5, abs=0.02) and found.stutters
    assert not sensor_qualities(joint(1000.0, rng))["joint_position"].stutters
    slow = 1e-3 * np.round(angle / 20.0 / 1e-3)
    assert grain_of(slow).repeated < 0.1, "counts of a slow motion repeat by themselves"


def test_gaps_constants_and_short_recordings(rng: np.random.Generator) -> None:
    plain = joint(1000.0, rng)
    torque = np.array(plain.motor_torque)
    torque[5000:5400] = np.nan
    found = sensor_qualities(replace(plain, motor_torque=torque, gauge_torque=np.full(torque.size, 3.0)))
    assert set(found) == {"joint_position", "motor_torque"}
    assert found["motor_torque"].noise == pytest.approx(TORQUE, rel=0.12)
    short = JointSignals("j", plain.time[:50], 1e-3, np.ones(50, bool), joint_position=plain.joint_position[:50])
    assert sensor_qualities(short) == {}


def test_the_count_is_the_smallest_step_of_whole_ones() -> None:
    angle = 0.4 * np.sin(np.arange(5000) * 2e-3)
    assert quantum(3e-5 * np.round(angle / 3e-5)) == pytest.approx(3e-5)
    fast = 2e-4 * np.round(80.0 * angle / 2e-4)
    assert quantum(fast) == pytest.approx(2e-4), "most samples move by many counts"
    assert quantum(angle) == 0.0 and quantum(np.ones(10)) == 0.0
    assert grain_of(np.full(20, np.nan)) == Grain()


def test_spectra_are_densities(rng: np.random.Generator) -> None:
    """White noise of deviation s at rate f has the density 2 s^2 / f; a sine of amplitude a the power a^2/2."""
    noise = 0.7 * rng.standard_normal(40_000)
    spectra = Segments.of([noise, noise + 0.1 * rng.standard_normal(noise.size)], 1e-3)
    assert spectra is not None
    assert np.median(spectra.power(0)) == pytest.approx(2.0 * 0.49 * 1e-3, rel=0.05)
    assert np.median(spectra.unexplained(1, [0])) == pytest.approx(2.0 * 0.01 * 1e-3, rel=0.1)
    np.testing.assert_allclose(np.median(spectra.unexplained(1)), np.median(spectra.power(1)), rtol=0.03)
    sine = 0.3 * np.sin(2.0 * np.pi * 80.0 * np.arange(40_000) * 1e-3)
    one = Segments.of([sine], 1e-3, 16)
    assert one is not None
    assert one.power(0).sum() * one.frequency[0] == pytest.approx(0.045, rel=0.03)
    assert noise_density_of(spectra.frequency, spectra.power(0), 1000.0) == pytest.approx(9.8e-4, rel=0.05)


@pytest.mark.parametrize("averaged", [False, True])
def test_differences_see_noise_and_no_steps(averaged: bool, rng: np.random.Generator) -> None:
    column = 0.2 * rng.standard_normal(20_000) + 50.0 * (np.arange(20_000) // 100 % 2)
    column = held_from_measured(column) if averaged else column
    assert difference_noise(column, averaged) == pytest.approx(0.2, rel=0.06)
    assert difference_noise(column[:3]) == np.inf


def test_a_cut_off_is_where_a_filter_begins() -> None:
    frequency = np.arange(1, 2001) * 0.05
    flat = np.full(frequency.size, 1e-4)
    assert np.isinf(cut_off(frequency, flat, 80.0))
    filtered = flat / (1.0 + (frequency / 10.0) ** 12)
    assert cut_off(frequency, filtered, 80.0) == pytest.approx(9.0, rel=0.25)
    assert np.isinf(cut_off(frequency, flat / (1.0 + (frequency / 10.0) ** 4), 80.0)), "12 dB per octave is motion"
