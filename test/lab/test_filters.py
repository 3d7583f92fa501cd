"""Filters of whole recordings: many columns at once as one by one; whitening is the recursion that it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from hd_control.lab.balances.noise import ORDER, Noise
from hd_control.lab.signals.filters import Band, Spectral

ROWS, PERIOD = 6000, 1e-3


def columns() -> np.ndarray:
    """Steps, waves, a drift and an offset, (n, 40): more than are filtered at once."""
    time = np.arange(ROWS) * PERIOD
    waves = [np.sign(np.sin(2.0 * np.pi * (0.7 + 0.3 * k) * time)) + 0.1 * k * time + k for k in range(20)]
    return np.stack([*waves, *(np.cos(2.0 * np.pi * (2.0 + k) * time) for k in range(20))], axis=1)


@pytest.mark.parametrize("band", [Band(38.0, 60.0, 8), Band(80.0, 122.0, 4), Band(8.0, 13.0, 30)])
def test_many_columns_are_filtered_as_one_is(band: Band) -> None:
    """Single precision: 24 bits, 2e-5 of the largest value after sums over a few thousand samples."""
    x, spectral = columns(), Spectral(ROWS, PERIOD)
    one_by_one = np.stack([spectral.filter(column, band) for column in x.T], axis=1)
    together = spectral.filter_columns(x, band)
    assert together.shape == one_by_one.shape == (spectral.rows(band), 40)
    assert np.abs(together - one_by_one).max() < 2e-5 * np.abs(x).max()
    np.testing.assert_allclose(spectral.filter(x, band), one_by_one, rtol=0.0, atol=1e-12 * np.abs(x).max())


def test_a_slow_signal_passes_and_its_derivatives_are_exact() -> None:
    time, spectral, band = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD), Band(38.0, 60.0, 8)
    omega = 2.0 * np.pi * 5.0
    inside = slice(200, -200)  # away from the reflected ends
    for derivative, exact in enumerate((np.sin, lambda x: omega * np.cos(x), lambda x: -(omega**2) * np.sin(x))):
        found = spectral.filter(np.sin(omega * time), band, derivative)
        np.testing.assert_allclose(found[inside], exact(omega * time[::8])[inside], atol=2e-3 * omega**derivative)


@pytest.mark.parametrize("rows", [5, ORDER, ORDER + 1, 64 + ORDER, 1000])
def test_whitening_is_the_recursion(rows: int, rng: np.random.Generator) -> None:
    noise = Noise(0.1 * rng.standard_normal(ORDER), 2.0, 1.0)
    x = rng.standard_normal((rows, 3))
    expected = x / noise.scale
    for k in range(ORDER, rows):
        expected[k] = (x[k] + sum(noise.lags[i] * x[k - 1 - i] for i in range(ORDER))) / noise.scale
    np.testing.assert_allclose(noise.whiten(x), expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(noise.whiten(x[:, 1]), expected[:, 1], rtol=0.0, atol=1e-12)
