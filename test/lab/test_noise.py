"""Noise of a channel: an autoregression that is known is found, and whitening by it leaves white rows of unit size."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hd_control.lab.balances.noise import LEVELS, ORDER, SPEED_BINS, Noise, fit_noise, with_history

ROWS = 20_000


def coloured(lags: list[float], scale: float, random: np.random.Generator, rows: int = ROWS) -> np.ndarray:
    """e_k + sum lags[i] e_{k-1-i} = scale * white."""
    return np.asarray(lfilter([scale], [1.0, *lags], random.standard_normal(rows)))


@pytest.mark.parametrize("rows", [5, ORDER, ORDER + 1, 64 + ORDER, 1000])
def test_whitening_is_the_recursion(rows: int, rng: np.random.Generator) -> None:
    noise = Noise(0.1 * rng.standard_normal(ORDER), 2.0, 1.0)
    x = rng.standard_normal((rows, 3))
    expected = x / noise.scale
    for k in range(ORDER, rows):
        expected[k] = (x[k] + sum(noise.lags[i] * x[k - 1 - i] for i in range(ORDER))) / noise.scale
    np.testing.assert_allclose(noise.whiten(x), expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(noise.whiten(x[:, 1]), expected[:, 1], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("lags", [[0.0], [-0.9], [-1.2, 0.6], [0.5, 0.3, -0.2]])
def test_a_known_autoregression_is_found(lags: list[float], rng: np.random.Generator) -> None:
    """Standard error of a coefficient of n rows is at most 1 / sqrt(n), 0.007; that of the scale 1 / sqrt(2 n)."""
    noise = fit_noise(coloured(lags, 0.3, rng), np.ones(ROWS, dtype=bool))
    expected = np.zeros(ORDER)
    expected[: len(lags)] = lags
    np.testing.assert_allclose(noise.lags, expected, atol=4.0 / np.sqrt(ROWS))
    # Rows beyond 4 sigma are left out of the scale: they hold 0.1 % of its square.
    assert noise.scale == pytest.approx(0.3, rel=4.0 / np.sqrt(2.0 * ROWS))


def test_the_deviation_is_that_of_the_coloured_noise_itself(rng: np.random.Generator) -> None:
    """For e_k = 0.9 e_{k-1} + w: 1 / sqrt(1 - 0.81) of the white part. Without its largest 0.5 %, 4 % of its square."""
    e = coloured([-0.9], 0.3, rng)
    noise = fit_noise(e, np.ones(ROWS, dtype=bool))
    assert noise.deviation == pytest.approx(0.3 / np.sqrt(0.19), rel=0.05)
    assert noise.with_deviation(e, 2.0).deviation == pytest.approx(2.0 * noise.deviation, rel=0.01)


def test_whitened_rows_are_white_with_unit_variance(rng: np.random.Generator) -> None:
    e = coloured([-1.2, 0.6], 0.3, rng)
    white = fit_noise(e[: ROWS // 2], np.ones(ROWS // 2, dtype=bool)).whiten(e)[ROWS // 2 :]
    assert np.mean(white**2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / white.size))
    for lag in (1, 2, 5, 20):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(white.size)


def test_bursts_stay_visible(rng: np.random.Generator) -> None:
    """1 % of the rows forty times too large: a plain variance would grow by a factor of 16."""
    e = 0.3 * rng.standard_normal(ROWS)
    e[5000:5200] *= 40.0
    noise = fit_noise(e, np.ones(ROWS, dtype=bool))
    assert noise.scale == pytest.approx(0.3, rel=0.02)
    assert np.abs(noise.whiten(e)[5000:5200]).max() > 60.0


def test_rows_without_a_valid_history_do_not_count(rng: np.random.Generator) -> None:
    """What lies in gaps may be anything."""
    valid = np.ones(ROWS, dtype=bool)
    valid[4000:4500] = valid[9000] = False
    e = coloured([-0.9], 0.3, rng)
    clean = fit_noise(e, valid)
    spoiled = fit_noise(np.where(valid, e, 1e3), valid)
    np.testing.assert_array_equal(clean.lags, spoiled.lags)
    assert clean.scale == spoiled.scale


@pytest.mark.parametrize("lags", [0, 1, 16])
def test_history_is_counted_as_by_hand(lags: int, rng: np.random.Generator) -> None:
    valid = rng.random(300) > 0.05
    by_hand = [k >= lags and bool(valid[k - lags : k + 1].all()) for k in range(300)]
    assert with_history(valid, lags).tolist() == by_hand
    assert Noise(np.zeros(lags), 1.0, 1.0).usable(valid).tolist() == by_hand


def test_noise_that_grows_with_speed_gets_its_levels(rng: np.random.Generator) -> None:
    """White part 1 + speed, between 1 and 2. Medians of 2500 rows are right within 2.5 %."""
    speed = np.linspace(-1.0, 1.0, ROWS)[rng.permutation(ROWS)]
    e = 0.2 * (1.0 + np.abs(speed)) * rng.standard_normal(ROWS)
    flat, rows = Noise(np.zeros(ORDER), 0.2, 0.2), np.arange(ROWS) >= ORDER
    noise = flat.levelled(e, speed, rows).scaled_on(e, speed, rows)
    assert noise.levels.size == SPEED_BINS and (np.diff(noise.speeds) > 0.0).all()
    at = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(noise.scale * noise.level(at), 0.2 * (1.0 + at), rtol=0.05)
    np.testing.assert_array_equal(noise.level(-at), noise.level(at))
    white = noise.whiten(e)[rows] / noise.level(speed[rows])
    assert np.mean(white**2) == pytest.approx(1.0, rel=0.05)


def test_levels_stay_within_their_limits_and_need_enough_rows(rng: np.random.Generator) -> None:
    speed = np.linspace(0.0, 1.0, ROWS)
    e = np.where(speed < 0.5, 1e-3, 1.0) * rng.standard_normal(ROWS)
    flat, rows = Noise(np.zeros(ORDER), 1.0, 1.0), np.arange(ROWS) >= ORDER
    assert flat.levelled(e, speed, rows).levels.min() == LEVELS[0]
    few = rows & (np.arange(ROWS) < 100)
    assert flat.levelled(e, speed, few) is flat
    assert flat.scaled_on(e, speed, np.zeros(ROWS, dtype=bool)) is flat


def test_other_units_scale_everything_but_the_colour() -> None:
    noise = Noise(np.full(ORDER, 0.01), 2.0, 3.0).divided(10.0)
    assert (noise.scale, noise.deviation) == (0.2, 0.3)
    np.testing.assert_array_equal(noise.lags, np.full(ORDER, 0.01))
