"""Signals of one joint at low frequency, with exact derivatives and shifts in time: what checks of signs, units and
delays are made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.bands import EDGE_S, Band, Spectral, band_for
from hd_control.analysis.joint_states import fill_gaps
from hd_control.analysis.signals import JointSignals
from hd_control.core.arrays import BoolArray, FloatArray

BAND = (8.0, 12.0)
"""Hz, flat and zero: rigid motion, gravity and friction; above it the noise of second derivatives begins."""
SPEED_BAND = (30.0, 50.0)
STANDSTILL = 0.01
"""rad/s over which the direction of motion changes its sign."""
FEWEST_ROWS = 60


class SlowRows:
    """Band-limited rows of the signals that a joint has. `usable` (rows,): no gap and no edge near."""

    def __init__(self, signals: JointSignals, gear_ratio: float) -> None:
        """Motor shaft angles are divided by the gear ratio."""
        self.period, self.present = signals.period, set(signals.present)
        self.spectral = Spectral(signals.time.size, signals.period)
        self.band = band_for(signals.period, *BAND)
        bins = self.spectral.frequency.size // self.band.step + 1  # the rows see no higher ones
        self._frequency, self._hold = self.spectral.frequency[:bins], self.spectral.hold()[:bins]
        self._spectra = {}
        bad = ~np.asarray(signals.valid)
        for name in ("motor_shaft_position", "joint_position", "gauge_torque", "motor_torque"):
            column = getattr(signals, name)
            if column is None:
                continue
            bad = bad | ~np.isfinite(column)
            scale = 1.0 / gear_ratio if name == "motor_shaft_position" else 1.0
            self._spectra[name] = self.spectral.transform(scale * fill_gaps(column))
        self.usable = self._usable(bad)
        self.position = "motor_shaft_position" if "motor_shaft_position" in self.present else "joint_position"
        self._direction = self._direction_rows()

    def rows(self, name: str, derivative: int = 0, advance: float = 0.0) -> FloatArray:
        """(rows,) of a signal's derivative, read `advance` seconds later; torque commands count as held."""
        factor = np.exp(2j * np.pi * advance * self._frequency)
        if name == "motor_torque":
            factor = factor * self._hold
        spectrum, trend = self._spectra[name]
        return self.spectral.back(spectrum, trend, self.band, derivative, factor)[:, 0]

    def friction(self) -> list[FloatArray]:
        """Direction and velocity of the motion, filtered like everything else, (rows,) each."""
        return [self._direction, self.rows(self.position, 1)]

    def link(self) -> list[FloatArray]:
        """Columns of a single link: acceleration, sine and cosine of the angle, one."""
        q = self.rows(self.position)
        return [self.rows(self.position, 2), np.sin(q), np.cos(q), np.ones(q.size)]

    def _direction_rows(self) -> FloatArray:
        spectrum, trend = self._spectra[self.position]
        fast = band_for(self.period, *SPEED_BAND)
        velocity = self.spectral.back(spectrum, trend, Band(fast.flat, fast.zero), 1)[:, 0]
        return self.spectral.filter(np.tanh(velocity / STANDSTILL), self.band)

    def _usable(self, bad: BoolArray) -> BoolArray:
        edge, margin = round(EDGE_S / self.period), round(self.band.support_s / self.period)
        bad = bad.copy()
        bad[:edge] = bad[bad.size - edge :] = True
        count = np.concatenate([[0], np.cumsum(bad)])
        index = np.arange(0, bad.size, self.band.step)
        low, high = np.maximum(index - margin, 0), np.minimum(index + margin + 1, bad.size)
        return np.asarray(count[high] == count[low])


@dataclass(frozen=True)
class Regression:
    """Least squares on the usable rows: coefficients (k,), root of their covariance (k, k), RMS of the left side about
    its mean and of what is left."""

    coefficients: FloatArray
    root: FloatArray
    spread: float
    rest: float

    def error(self, index: int) -> float:
        """Standard error of a coefficient."""
        return float(np.linalg.norm(self.root[index]))

    def t(self, index: int) -> float:
        """Coefficient over its standard error."""
        return float(self.coefficients[index]) / max(1e-300, self.error(index))

    def t_of(self, weights: FloatArray) -> float:
        """The weighted sum of the coefficients over its standard error."""
        return float(weights @ self.coefficients) / max(1e-300, float(np.linalg.norm(weights @ self.root)))


def regress(left: FloatArray, columns: Sequence[FloatArray], usable: BoolArray) -> Regression:
    """Coefficients of the columns (rows,) for the left side (rows,). The errors allow for correlated residuals.

    Columns that are (almost) a combination of the others get a huge standard error instead of a number by chance.
    """
    y, a = left[usable], np.column_stack(columns)[usable]
    scale = np.sqrt((a**2).mean(axis=0)) + 1e-300
    u, s, vt = np.linalg.svd(a / scale, full_matrices=False)
    s = np.maximum(s, 1e-9 * s[0])
    solution = vt.T @ ((u.T @ y) / s)
    residual = y - (a / scale) @ solution
    variance = float(residual @ residual) / max(1, y.size - s.size) * _independent(residual)
    root = np.sqrt(variance) * (vt.T / s) / scale[:, None]
    return Regression(solution / scale, root, float(y.std()), float(np.sqrt(np.mean(residual**2))))


def _independent(residual: FloatArray) -> float:
    """Rows per independent row, from the first lags of the autocorrelation."""
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power <= 0.0 or centred.size < 8:
        return 1.0
    total = 1.0
    for lag in range(1, centred.size // 4):
        correlation = float(centred[lag:] @ centred[:-lag]) / power
        if correlation < 0.05:
            break
        total += 2.0 * correlation
    return total
