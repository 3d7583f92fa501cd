"""Filters of whole recordings: gains and derivatives against their closed forms, ends, many columns at once."""

from __future__ import annotations

import numpy as np
import pytest

from hd_control.lab.signals.filters import EDGE_S, STEPS, Band, Spectral, band_for, fill_gaps

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


def phasor(time: np.ndarray, values: np.ndarray, frequency: float) -> complex:
    """values = real part of phasor * exp(2 pi i f t), by least squares."""
    angle = 2.0 * np.pi * frequency * time
    (cosine, sine), *_ = np.linalg.lstsq(np.column_stack([np.cos(angle), np.sin(angle)]), values, rcond=None)
    return complex(cosine, -sine)


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("frequency", [4.0, 38.0, 45.0, 49.0, 55.0, 59.0])
def test_gain_and_phase_are_those_of_the_taper_times_the_derivative(frequency: float, derivative: int) -> None:
    """Flat to 38 Hz, a half cosine to 60 Hz, no phase: gain (2 pi i f)^d (1 + cos(pi (f - 38) / 22)) / 2."""
    time, spectral, band = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD), Band(38.0, 60.0, 4)
    taper = 1.0 if frequency < 38.0 else 0.5 * (1.0 + np.cos(np.pi * (frequency - 38.0) / 22.0))
    found = spectral.filter(np.cos(2.0 * np.pi * frequency * time), band, derivative)
    inside = slice(round(EDGE_S / PERIOD / 4), -round(EDGE_S / PERIOD / 4))
    measured = phasor(time[::4][inside], found[inside], frequency)
    scale = (2.0 * np.pi * frequency) ** derivative
    assert measured == pytest.approx(taper * (2j * np.pi * frequency) ** derivative, abs=1e-4 * scale)


@pytest.mark.parametrize("frequency", [61.0, 200.0, 437.0])
def test_nothing_passes_beyond_the_zero_and_nothing_folds_back(frequency: float) -> None:
    """437 Hz would fold to 63 Hz at every second sample, 200 Hz to 0 Hz at every fifth."""
    time, spectral = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD)
    found = spectral.filter(np.cos(2.0 * np.pi * frequency * time), Band(38.0, 60.0, 5))
    inside = slice(round(EDGE_S / PERIOD / 5), -round(EDGE_S / PERIOD / 5))
    assert np.abs(found[inside]).max() < 1e-4


def test_a_drift_passes_whole_with_its_slope_to_the_ends() -> None:
    """The trend is taken out before the transform: a position that does not return leaves no step."""
    time, spectral, band = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD), Band(8.0, 13.0, 30)
    drift = 3.0 - 2.0 * time
    np.testing.assert_allclose(spectral.filter(drift, band), drift[::30], atol=1e-12)
    np.testing.assert_allclose(spectral.filter(drift, band, 1), -2.0, atol=1e-10)
    np.testing.assert_allclose(spectral.filter(drift, band, 2), 0.0, atol=1e-9)


def test_after_the_edge_the_ends_are_forgotten() -> None:
    """A recording in the middle of a motion: beyond `EDGE_S` its filtered part is that of a longer recording."""
    time, band = np.arange(-4000, ROWS + 4000) * PERIOD, Band(38.0, 60.0, 1)
    long = np.sin(2.0 * np.pi * 0.3 * time) + 0.05 * np.sin(2.0 * np.pi * 11.0 * time + 1.0)
    whole = Spectral(long.size, PERIOD).filter(long, band, 2)[4000:-4000]
    part = Spectral(ROWS, PERIOD).filter(long[4000:-4000], band, 2)
    edge, scale = round(EDGE_S / PERIOD), np.abs(whole).max()
    assert np.abs(part - whole)[edge:-edge].max() < 2e-4 * scale
    assert np.abs(part - whole)[: edge // 10].max() > 2e-2 * scale, "at the very end there is something to forget"


def test_a_hold_is_the_mean_over_the_tick_that_begins_at_the_sample() -> None:
    """Each value acts over [t, t + T): seen at t the mean of its effect is half a period late. A further delay adds."""
    time, spectral, band = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD), Band(150.0, 240.0, 1)
    inside = slice(round(EDGE_S / PERIOD), -round(EDGE_S / PERIOD))
    for frequency, delay in ((20.0, 0.0), (100.0, 0.0), (100.0, 2.7e-3)):
        held = spectral.filter(np.cos(2.0 * np.pi * frequency * time), band, 0, spectral.hold(delay))
        x = np.pi * frequency * PERIOD
        expected = np.sin(x) / x * np.exp(-1j * (x + 2.0 * np.pi * frequency * delay))
        assert phasor(time[inside], held[inside], frequency) == pytest.approx(expected, abs=1e-4)


def test_a_delay_moves_the_trend_too() -> None:
    time, spectral, band = np.arange(ROWS) * PERIOD, Spectral(ROWS, PERIOD), Band(38.0, 60.0, 8)
    late = spectral.filter(5.0 * time, band, 0, spectral.hold(0.02))
    np.testing.assert_allclose(late, 5.0 * (time[::8] - 0.0205), atol=1e-9)


@pytest.mark.parametrize("rate", [50.0, 125.0, 200.0, 250.0, 500.0, 1000.0, 4000.0])
def test_a_band_fits_every_rate(rate: float) -> None:
    """Zero stays at or below 0.4 of the rate, the kept rate at or above 2.04 of the zero; the ratio of both edges."""
    for flat, zero in ((80.0, 122.0), (38.0, 60.0), (8.0, 13.0)):
        band = band_for(1.0 / rate, flat, zero)
        assert band.zero <= min(zero, 0.4 * rate) * (1.0 + 1e-12)
        assert band.flat / band.zero == pytest.approx(flat / zero)
        assert band.step in STEPS and (band.step == 1 or rate / band.step >= 2.04 * band.zero)
        larger = [step for step in STEPS if step > band.step]
        assert not larger or rate / larger[0] < 2.04 * band.zero, "no more rows than needed"
    assert band_for(1e-3, 38.0, 60.0) == Band(38.0, 60.0, 8)


def test_the_support_is_where_a_single_sample_is_smeared() -> None:
    """Of the energy of the answer to a single sample 1 % lies beyond, in side lobes of a tenth of its height."""
    for band in (Band(38.0, 60.0, 1), Band(8.0, 12.0, 1)):
        one = np.zeros(ROWS)
        one[ROWS // 2] = 1.0
        answer = np.abs(Spectral(ROWS, PERIOD).filter(one, band))
        far = np.abs(np.arange(ROWS) - ROWS // 2) * PERIOD > band.support_s
        assert 0.005 < np.sum(answer[far] ** 2) / np.sum(answer**2) < 0.01 and answer[far].max() < 0.1 * answer.max()


def test_gaps_are_filled_with_straight_lines() -> None:
    x = np.array([np.nan, 1.0, np.nan, np.nan, 4.0, np.nan])
    assert fill_gaps(x).tolist() == [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    assert fill_gaps(np.full(3, np.nan)).tolist() == [0.0, 0.0, 0.0]
    whole = np.arange(3.0)
    assert fill_gaps(whole) is whole


def test_short_recordings_are_filtered_too() -> None:
    """Shorter than the reflection on either side."""
    for rows in (10, 130, 700):
        time = np.arange(rows) * PERIOD
        found = Spectral(rows, PERIOD).filter(2.0 + time, Band(38.0, 60.0, 8))
        assert found.shape == (-(-rows // 8),)
        np.testing.assert_allclose(found, (2.0 + time)[::8], atol=1e-9)
