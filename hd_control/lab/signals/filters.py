"""Zero-phase filters, derivatives and decimation in the frequency domain, for whole recordings at once.

One instance belongs to one evenly spaced recording. Signals are continued at both ends by odd reflection, their trend
is removed before the transform and restored after it, so that a position that does not return leaves no step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray

PADDING_S = 2.4
STEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 24, 30)
COLUMNS_AT_ONCE = 16
"""Columns that are filtered together: few enough that their spectra stay in the cache."""
EDGE_S = 0.5
"""s cut at both ends of a recording: there the filters have seen the reflection."""


@dataclass(frozen=True)
class Band:
    """Flat to `flat` Hz, cosine taper to zero at `zero` Hz, then every `step`-th sample is kept."""

    flat: float
    zero: float
    step: int = 1

    def gain(self, frequency: FloatArray) -> FloatArray:
        """The filter's gain at `frequency` Hz."""
        x = np.clip((frequency - self.flat) / (self.zero - self.flat), 0.0, 1.0)
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * x))

    @property
    def support_s(self) -> float:
        """s on each side over which a single sample is smeared noticeably (side lobes of the taper)."""
        return 2.5 / (self.flat + self.zero)


def band_for(period: float, flat: float, zero: float) -> Band:
    """A band for samples of `period` s, lowered where the rate does not carry it, kept at 2.04 x `zero` or more."""
    rate = 1.0 / period
    scale = min(1.0, 0.4 * rate / zero)
    flat, zero = scale * flat, scale * zero
    step = max(divisor for divisor in STEPS if divisor <= max(1.0, rate / (2.04 * zero)))
    return Band(flat, zero, step)


class Spectral:
    """Filters for signals of `samples` samples, `period` s apart; every `Band.step` must divide `multiple`."""

    def __init__(self, samples: int, period: float, multiple: int = 120) -> None:
        from scipy.fft import next_fast_len

        self.samples, self.period = samples, period
        pad = min(round(PADDING_S / period), samples - 1)
        self._pad = pad - pad % multiple
        self._length = multiple * next_fast_len(-(-(samples + 2 * self._pad) // multiple), real=True)

    @cached_property
    def frequency(self) -> FloatArray:
        """Hz of the bins, (length // 2 + 1,)."""
        return np.asarray(np.fft.rfftfreq(self._length, self.period))

    def transform(
        self, signal: FloatArray, precision: type[np.floating[Any]] = np.float64
    ) -> tuple[NDArray[np.complexfloating[Any, Any]], FloatArray]:
        """Spectrum (k, bins) and trend (2, k) of signals (n,) or (n, k) without gaps."""
        from scipy.fft import rfft

        x = signal.reshape(self.samples, -1).T
        pad, end = self._pad, self._pad + self.samples
        start, stop = x[:, :1], x[:, -1:]
        first = 2.0 * start - x[:, pad : pad + 1]
        last = 2.0 * stop - x[:, -pad - 1 : self.samples - pad] if pad else stop
        slope = (last - first) / max(1, end + pad - 1)
        padded = np.zeros((x.shape[0], self._length), dtype=precision)
        np.subtract(x, first, out=padded[:, pad:end], casting="same_kind")
        np.subtract(2.0 * start - first, x[:, pad:0:-1], out=padded[:, :pad], casting="same_kind")
        tail = x[:, -2 : -pad - 2 : -1] if pad else x[:, :0]
        np.subtract(2.0 * stop - first, tail, out=padded[:, end : end + pad], casting="same_kind")
        ramp = np.arange(end + pad, dtype=precision)
        for row, rise in zip(padded, slope[:, 0].astype(precision), strict=True):
            row[: end + pad] -= rise * ramp
        trend = np.stack([(first + slope * pad)[:, 0], slope[:, 0] / self.period])
        return rfft(padded, axis=1, overwrite_x=True), trend

    def back(
        self,
        spectrum: NDArray[np.complexfloating[Any, Any]],
        trend: FloatArray,
        band: Band,
        derivative: int = 0,
        factor: NDArray[np.complex128] | None = None,
    ) -> FloatArray:
        """The filtered `derivative`-th derivative, (rows, k), at every `band.step`-th sample.

        `factor` (bins,) multiplies the spectrum further (delay, hold); at 0 Hz it must be 1.
        """
        from scipy.fft import irfft

        length = self._length // band.step
        bins = length // 2 + 1
        frequency = self.frequency[:bins]
        power = (2j * np.pi * frequency) ** derivative
        gain = np.asarray(power * band.gain(frequency) / band.step, dtype=np.complex128)
        if factor is not None:
            gain *= factor[:bins]
        start, rows = self._pad // band.step, self.rows(band)
        shaped = spectrum[:, :bins] * gain.astype(spectrum.dtype)
        x = irfft(shaped, length, axis=1, overwrite_x=True)[:, start : start + rows].astype(np.float64)
        if derivative == 0:
            delay = 0.0 if factor is None else _group_delay(factor, self.frequency)
            x += trend[0, :, None] + trend[1, :, None] * (band.step * self.period * np.arange(rows) - delay)
        elif derivative == 1:
            x += trend[1, :, None]
        return np.asarray(x.T)

    def filter(
        self,
        signal: FloatArray,
        band: Band,
        derivative: int = 0,
        factor: NDArray[np.complex128] | None = None,
    ) -> FloatArray:
        """`back(transform(signal))` in the shape of `signal`: (rows,) or (rows, k)."""
        x = self.back(*self.transform(signal), band, derivative, factor)
        return x[:, 0] if signal.ndim == 1 else x

    def filter_columns(self, columns: FloatArray, band: Band) -> FloatArray:
        """`filter` of many columns (n, k) -> (rows, k), a few at a time, in single precision.

        The error is below 2e-5 of the largest column (tested), far below what a column has to explain.
        """
        found = np.empty((self.rows(band), columns.shape[1]))
        for at in range(0, columns.shape[1], COLUMNS_AT_ONCE):
            part = slice(at, at + COLUMNS_AT_ONCE)
            found[:, part] = self.back(*self.transform(columns[:, part], np.float32), band)
        return found

    def rows(self, band: Band) -> int:
        """Number of samples that a band keeps."""
        return -(-self.samples // band.step)

    def hold(self, delay: float = 0.0) -> NDArray[np.complex128]:
        """Spectrum factor of a zero-order hold over one period, and a further delay of `delay` s."""
        f = self.frequency
        return np.asarray(np.sinc(f * self.period) * np.exp(-1j * np.pi * f * (self.period + 2.0 * delay)))


def _group_delay(factor: NDArray[np.complex128], frequency: FloatArray) -> float:
    """Delay s of a factor at low frequency."""
    return float(-np.angle(factor[1]) / (2.0 * np.pi * frequency[1]))


def fill_gaps(signal: FloatArray) -> FloatArray:
    """The signal with NaN replaced by straight lines between the neighbours. All NaN gives zeros."""
    bad = ~np.isfinite(signal)
    if not bad.any():
        return signal
    index = np.arange(signal.size)
    if bad.all():
        return np.zeros_like(signal)
    return np.interp(index, index[~bad], signal[~bad])
