"""What the sensors of a joint resolve and how noisy they are, measured from the recording alone, without any model.

    S_y|x(f) = S_yy - S_yx S_xx^-1 S_xy                power of a signal y that the other signals x do not explain
    density  = median of S_y|x over the highest frequencies
    noise    = sqrt(density * rate / 2)                standard deviation per sample of white noise of that density

Sensors' noise is what is left at high frequency, where a robot hardly moves. What the other signals explain there is no
noise: a servo answers the counts of its encoder with a torque, and that torque is real. A torque that was smoothed
before it was recorded holds no noise above its cut-off, which says nothing of the noise below it: then there is no
number (NaN). A count (the step of a quantised signal) is a noise of count^2/12.

Method: Bendat, Piersol, Random Data, 4th ed., section 7.3 (residual spectra of several inputs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.lab.signals.filters import fill_gaps
from hd_control.lab.signals.joint_signals import Grain, JointSignals, grain_of

UNITS = {"motor_shaft_position": "rad", "joint_position": "rad", "gauge_torque": "N m", "motor_torque": "N m"}
"""Sensors that are judged, with their units."""
EXPLAINED_BY = {
    "motor_shaft_position": (),
    "joint_position": (),
    "gauge_torque": ("motor_shaft_position", "joint_position"),
    "motor_torque": ("motor_shaft_position", "joint_position", "gauge_torque"),
}
"""Signal -> those whose noise comes back in it through the servo."""
SHORTEST, NOISE_SEGMENT = 32, 128
"""Samples of a segment at least, and where noise is read: so short that many hold no reversal."""
LONGEST = 8192
LONG_SEGMENTS = 4
"""Segments where a cut-off is looked for, which may be low."""
BURST = 3.0
"""A segment whose power at high frequency is so many standard deviations above the median of all holds a reversal or a
shock; it is left out."""
ROUNDS = 3
TOP, HIGHEST = 0.2, 0.42
"""Frequencies over the rate between which noise is read; a mean over each tick is zero at half the rate."""
STEEP, ON = 18.0, 12.0
"""dB per octave by which a filter lets a spectrum fall at its cut-off, and further on."""
EMPTY = 40.0
"""dB that a smoothed signal loses above its cut-off at least."""
NO_SENSOR = 3e-5
"""Noise at the highest frequencies, over the range of the signal, that no torque sensor has: it was smoothed."""
LEAST_REPEATED = 0.2


@dataclass(frozen=True)
class SensorQuality:
    """One sensor. `step`: its count in `unit`, 0 if none is seen; `noise` per sample and its one-sided `density` in
    unit^2/Hz, NaN if it was smoothed; `smoothed_above` Hz, infinite if it is not; `repeated`: share of samples that
    repeat the one before while the signal moves; `rate` Hz of the recording; `averaged`: its column holds the mean over
    each tick of what was measured."""

    signal: str
    unit: str
    step: float
    noise: float
    density: float
    smoothed_above: float
    repeated: float
    rate: float
    averaged: bool = False

    @property
    def floor_density(self) -> float:
        """Density that no error can fall below: measured, and not less than that of the counts."""
        return max(float(np.nan_to_num(self.density)), self.step**2 / 6.0 / self.rate)

    @property
    def stutters(self) -> bool:
        """Is it recorded more often than it is measured?"""
        return self.repeated > LEAST_REPEATED

    def json(self) -> dict[str, Any]:
        """The form of `sensors` in `hd.compare/1`."""
        return {
            "unit": self.unit,
            "step": self.step or None,
            "noise": self.noise if np.isfinite(self.noise) else None,
            "noise_density": self.density if np.isfinite(self.density) else None,
            "smoothed_above_hz": self.smoothed_above if np.isfinite(self.smoothed_above) else None,
            "repeated_share": self.repeated,
            "rate_hz": self.rate,
        }


def sensor_qualities(signals: JointSignals) -> dict[str, SensorQuality]:
    """Every sensor that the joint has and that is not constant, by signal."""
    names = [name for name in UNITS if _varies(getattr(signals, name))]
    spectra = Segments.of([getattr(signals, name) for name in names], signals.period) if names else None
    if spectra is None:
        return {}
    return {name: _quality(signals, name, names, spectra) for name in names}


def _varies(column: FloatArray | None) -> bool:
    return column is not None and bool(np.isfinite(column).any()) and float(np.nanmax(column) - np.nanmin(column)) > 0.0


def _quality(signals: JointSignals, name: str, names: Sequence[str], spectra: Segments) -> SensorQuality:
    column = getattr(signals, name)
    grain = signals.grains.get(name) or grain_of(column)
    own = names.index(name)
    rate = 1.0 / signals.period
    cut = np.inf
    if UNITS[name] == "N m" and (long := Segments.of([column], signals.period, LONG_SEGMENTS)) is not None:
        top = np.sqrt(0.5 * rate * noise_density_of(long.frequency, long.unexplained(0), rate))
        if top < NO_SENSOR * float(np.nanmax(column) - np.nanmin(column)):
            cut = cut_off(long.frequency, long.power(0) / _shape(grain, long), HIGHEST * rate)
    density = np.nan
    if np.isinf(cut):
        others = [names.index(x) for x in EXPLAINED_BY[name] if x in names]
        density = noise_density_of(spectra.frequency, spectra.unexplained(own, others) / _shape(grain, spectra), rate)
        if UNITS[name] == "N m":
            density = min(density, 2.0 / rate * difference_noise(column, grain.averaged) ** 2)
    noise = float(np.sqrt(0.5 * density * rate))
    return SensorQuality(name, UNITS[name], grain.step, noise, density, cut, grain.repeated, rate, grain.averaged)


def _shape(grain: Grain, spectra: Segments) -> FloatArray:
    """What the mean over each tick leaves of white noise, over frequency."""
    if not grain.averaged:
        return np.ones(spectra.frequency.size)
    return np.asarray(np.maximum(np.cos(np.pi * spectra.frequency * spectra.period) ** 2, 1e-6))


def noise_density_of(frequency: FloatArray, power: FloatArray, rate: float) -> float:
    """Density of the noise (unit^2/Hz) from a spectrum (k,): its median at high frequency; that of a mean over each
    tick ends earlier, for it is zero at half the rate."""
    rows = (frequency >= TOP * rate) & (frequency <= HIGHEST * rate)
    return float(np.median(power[rows])) if rows.any() else 0.0


def difference_noise(column: FloatArray, averaged: bool = False) -> float:
    """Standard deviation of white noise from the middle size of the third differences of a column (n,): steps of
    friction touch few of them. `averaged`: the column is the mean over each tick."""
    third = np.abs(np.diff(column, 3))
    third = third[np.isfinite(third)]
    return float(1.4826 * np.median(third) / np.sqrt(2.5 if averaged else 20.0)) if third.size else np.inf


def cut_off(frequency: FloatArray, power: FloatArray, highest: float) -> float:
    """Hz from which on the spectrum (k,) of a signal falls as behind a filter, up to `highest`; infinite if it nowhere
    does: by `STEEP` dB in an octave, then on by `ON` until it has lost `EMPTY`."""
    octave = 4
    step = 2.0 ** (1.0 / octave)
    centres = highest / step ** np.arange(60)[::-1]
    centres = centres[centres >= 4.0 * frequency[0]]
    level = np.array([_level(frequency, power, centre, step) for centre in centres])
    for i in range(centres.size - octave):
        down = np.flatnonzero(level[i] - level[i:] >= EMPTY)
        end = i + int(down[0]) if down.size else centres.size
        falls = level[i : centres.size - octave] - level[i + octave :]
        if down.size and falls[0] >= STEEP and (falls[: max(1, end - i - octave)] >= ON).all():
            return float(centres[i])
    return np.inf


def _level(frequency: FloatArray, power: FloatArray, centre: float, step: float) -> float:
    """dB around a frequency."""
    rows = (frequency >= centre / step**0.5) & (frequency < centre * step**0.5)
    near = power[rows] if rows.any() else power[[int(np.argmin(np.abs(frequency - centre)))]]
    return float(10.0 * np.log10(np.median(near) + 1e-300))


# ---- Spectra of all signals together ---------------------------------------------------------------


@dataclass(frozen=True)
class Segments:
    """Spectra (segments, k, frequencies) of k signals at `frequency` Hz, scaled so that their mean square is the
    one-sided density; samples are `period` s apart."""

    frequency: FloatArray
    spectra: NDArray[np.complex128]
    period: float

    @classmethod
    def of(cls, columns: Sequence[FloatArray], period: float, segments: int = 0) -> Segments | None:
        """Of columns (n,), half overlapping (Welch): that many `segments` without overlap, or short ones for noise.
        None if fewer than four have no gap.

        The segments are second differences, so that the motion does not leak into the noise.
        """
        table = np.stack([fill_gaps(column) for column in columns])
        bad = np.concatenate([[0], np.cumsum(~np.isfinite(np.stack(list(columns))).all(axis=0))])
        wanted = table.shape[1] // segments if segments else min(NOISE_SEGMENT, table.shape[1] // 60)
        length = int(np.clip(2 ** int(np.log2(max(2, wanted))), SHORTEST, LONGEST))
        window = np.hanning(length + 1)[:-1]
        gain = (2.0 * np.sin(np.pi * np.arange(1, length // 2 + 1) / length)) ** 2
        starts = np.arange(0, table.shape[1] - length - 1, length // 2)
        starts = starts[bad[starts + length + 2] == bad[starts]]
        if starts.size < 4:
            return None
        second = np.diff(table, 2)
        pieces = np.stack([second[:, at : at + length] for at in starts])
        scale = np.sqrt(2.0 * period / float(np.sum(window**2)))
        spectra = scale * np.fft.rfft(pieces * window)[:, :, 1:] / gain
        return cls(np.arange(1, length // 2 + 1) / (length * period), spectra, period)

    def power(self, index: int) -> FloatArray:
        """Density of one signal, unit^2/Hz, (frequencies,)."""
        return np.asarray((np.abs(self.spectra[:, index]) ** 2).mean(axis=0))

    def unexplained(self, index: int, others: Sequence[int] = ()) -> FloatArray:
        """Density of one signal that the others do not explain, (frequencies,), without the segments with bursts."""
        left, used = self.spectra[:, index], np.ones(len(self.spectra), bool)
        top = self.frequency >= TOP / self.period
        for _ in range(ROUNDS):
            left = left if not others else self._residual(index, list(others), used)
            loud = (np.abs(left[:, top]) ** 2).mean(axis=1)
            used = loud <= (1.0 + BURST / np.sqrt(max(1, top.sum()))) * np.median(loud)
        free = max(1.0, 0.6 * used.sum())  # half overlapping Hann segments
        return np.asarray((np.abs(left[used]) ** 2).mean(axis=0) * free / max(1.0, free - len(others)))

    def _residual(self, index: int, others: list[int], used: BoolArray) -> NDArray[np.complex128]:
        """What a least-squares filter of the others, fitted on the used segments, leaves of a signal, (segments, k)."""
        x, y = self.spectra[:, others], self.spectra[:, index]
        x = x / (np.sqrt((np.abs(x) ** 2).mean(axis=0)) + 1e-300)
        inner = np.einsum("sif,sjf->fij", x[used].conj(), x[used]) + 1e-9 * used.sum() * np.eye(len(others))
        right = np.einsum("sif,sf->fi", x[used].conj(), y[used])
        filters = np.linalg.solve(inner, right[:, :, None])[:, :, 0]
        return np.asarray(y - np.einsum("sif,fi->sf", x, filters))
