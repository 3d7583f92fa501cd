"""Noise of angles with quantisation and jitter, and power of innovations above the effects, from made signals."""

import numpy as np
import pytest

from hd_control.lab.innovations.noise import fast_power, sensor_variance

PERIOD, SAMPLES = 1e-3, 40_000


def motion() -> tuple[np.ndarray, np.ndarray]:
    time = PERIOD * np.arange(SAMPLES)
    return 1.2 * np.sin(0.9 * time), 1.2 * 0.9 * np.cos(0.9 * time)


@pytest.mark.parametrize("jitter", [0.0, 2e-5])
def test_own_noise_and_jitter_of_the_stamps_are_separated(jitter: float) -> None:
    angle, speed = motion()
    random = np.random.default_rng(1)
    reading = angle + 4e-6 * random.standard_normal(SAMPLES) + jitter * speed * random.standard_normal(SAMPLES)
    found = sensor_variance(reading, speed, np.ones(SAMPLES, dtype=bool), 4e-6, 0.0)
    wanted = 4e-6**2 + (jitter * speed) ** 2
    assert np.allclose(found, wanted, rtol=0.15)


def test_an_angle_is_never_known_better_than_its_counts() -> None:
    angle, speed = motion()
    found = sensor_variance(angle, speed, np.ones(SAMPLES, dtype=bool), 1e-12, 6e-5)
    assert found.min() >= 6e-5**2 / 12.0


def test_a_short_recording_takes_the_density() -> None:
    angle, speed = motion()
    use = np.zeros(SAMPLES, dtype=bool)
    use[:100] = True
    assert np.allclose(sensor_variance(angle, speed, use, 5e-6, 0.0), 5e-6**2)


def test_the_fast_power_of_white_noise_is_its_variance_whatever_is_slow_or_a_line() -> None:
    random = np.random.default_rng(2)
    time = PERIOD * np.arange(SAMPLES)
    use = np.ones(SAMPLES, dtype=bool)
    white = 1.5 * random.standard_normal(SAMPLES)
    slow, line = 5.0 * np.sin(2 * np.pi * 3.0 * time), 2.0 * np.sin(2 * np.pi * 125.0 * time)
    assert fast_power(white, PERIOD, use) == pytest.approx(2.25, rel=0.05)
    assert fast_power(white + slow, PERIOD, use) == pytest.approx(2.25, rel=0.2)
    assert fast_power(white + line, PERIOD, use) < 1.5 * 2.25
    assert fast_power(white, PERIOD, ~use) == 1.0
