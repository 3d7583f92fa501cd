"""One joint's columns, and long recordings at a lower rate without moving anything."""

from __future__ import annotations

import numpy as np
import pytest

from hd_control.lab.signals.joint_signals import HALF_WIDTH, LONGEST_ROWS, SIGNALS, JointSignals, decimate, factor_of


def phasor(time: np.ndarray, values: np.ndarray, frequency: float) -> complex:
    """Amplitude and phase of a sinusoid: values = real part of phasor * exp(2 pi i f t)."""
    angle = 2 * np.pi * frequency * time
    (cosine, sine), *_ = np.linalg.lstsq(np.column_stack([np.cos(angle), np.sin(angle)]), values, rcond=None)
    return complex(cosine, -sine)


def test_a_long_recording_is_decimated_without_moving_anything() -> None:
    assert [factor_of(rows) for rows in (1000, LONGEST_ROWS, LONGEST_ROWS + 1, 3 * LONGEST_ROWS)] == [1, 1, 3, 3]
    period, factor = 1e-3, 3
    time = np.arange(30_000) * period
    slow = time[::factor]
    inner = slice(100, -100)
    for frequency in (2.0, 20.0, 60.0, 100.0):
        wave = np.sin(2 * np.pi * frequency * time)
        measured = phasor(slow[inner], decimate(wave, factor, held=False)[inner], frequency)
        assert measured == pytest.approx(-1j, abs=1e-3)
        # Held over the long period, the decimated torque acts as the fast one did: equal amplitude, equal phase.
        held = phasor(slow[inner], decimate(wave, factor, held=True)[inner], frequency)
        long, short = frequency * factor * period, frequency * period
        acts = held * np.sinc(long) * np.exp(-1j * np.pi * long)
        assert acts == pytest.approx(-1j * np.sinc(short) * np.exp(-1j * np.pi * short), abs=1e-3)
    broken = np.sin(time)
    broken[9000:9100] = np.nan
    low = decimate(broken, factor, held=False)
    assert np.isnan(low[3000:3033]).all() and np.isfinite(low[:2900]).all() and np.isfinite(low[3100:]).all()


def test_the_factor_is_odd_and_just_enough() -> None:
    """The middle of a block of held values must be a sample."""
    for longest in (7, 100, 1001):
        for rows in (1, longest, longest + 1, 2 * longest, 3 * longest + 1, 8 * longest - 1, 40 * longest):
            factor = factor_of(rows, longest)
            assert factor % 2 == 1 and rows <= factor * longest
            assert factor == 1 or rows > (factor - 2) * longest, "no larger than needed"


@pytest.mark.parametrize("factor", [3, 5, 9])
@pytest.mark.parametrize("held", [False, True])
def test_what_would_fold_into_the_pass_band_is_gone(factor: int, held: bool) -> None:
    """Pass band to 0.8 of the new Nyquist frequency; 1.2 folds exactly onto its edge, 2.0 onto a constant."""
    time, nyquist = np.arange(20_000) * 1e-3, 500.0 / factor
    for share in (1.25, 1.6, 2.0):
        low = decimate(np.cos(2.0 * np.pi * share * nyquist * time + 0.3), factor, held)
        assert np.abs(low[50:-50]).max() < 3e-3, "a window of 25 blocks damps by 50 dB"


@pytest.mark.parametrize("held", [False, True])
def test_a_drift_keeps_its_place_and_its_ends(held: bool) -> None:
    """Straight lines are continued oddly at both ends. A held value of a block is the mean of its values."""
    line = 2.0 + 0.01 * np.arange(3000)
    low = decimate(line, 3, held)
    expected = line[::3] + (0.01 if held else 0.0)
    np.testing.assert_allclose(low, expected, atol=2e-5)
    assert decimate(np.full(3001, 7.0), 3, held).size == 1000


def test_a_gap_spoils_no_more_than_the_filter_reaches() -> None:
    values = np.sin(np.arange(30_000) * 1e-3)
    values[15_000] = np.nan
    low = decimate(values, 3, held=False)
    assert np.flatnonzero(np.isnan(low)).tolist() == list(range(5000 - HALF_WIDTH, 5000 + HALF_WIDTH + 1))
    assert np.isnan(decimate(np.full(3000, np.nan), 3, held=False)).all()


def test_present_names_the_columns_that_are_there_in_their_order() -> None:
    time = np.arange(5.0)
    signals = JointSignals("j", time, 1.0, np.ones(5, bool), gauge_torque=time, temperature=time, joint_position=time)
    assert signals.present == ("joint_position", "gauge_torque", "temperature")
    assert JointSignals("j", time, 1.0, np.ones(5, bool)).present == ()
    assert set(signals.present) <= set(SIGNALS)
