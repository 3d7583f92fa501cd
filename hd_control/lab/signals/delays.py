"""Delays between a joint's signals: the shift in time with which the balances fit best.

    q(t + D) - phi = tau_s / k + ...
    u(t + D) = tau_s + I phi'' + friction
    tau_s(t + D) = J q'' + g(q) + friction             J q'' and g(q) those of the robot description, if there is one

The shift is exact (in the frequency domain); what is left at each shift follows from one projection. `SlowRows` are the
signals at low frequency with exact derivatives and shifts, of which checks of signs and units are made, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.lab.signals.filters import EDGE_S, Band, Spectral, band_for, fill_gaps
from hd_control.lab.signals.joint_signals import JointSignals

# ---- Signals at low frequency ----------------------------------------------------------------------


BAND = (8.0, 12.0)
"""Hz, flat and zero: rigid motion, gravity and friction; above it the noise of second derivatives begins."""
SPEED_BAND = (30.0, 50.0)
STANDSTILL = 0.01
"""rad/s over which the direction of motion changes its sign."""
FEWEST_ROWS = 60


class SlowRows:
    """Band-limited rows of the signals that a joint has. `usable` (rows,): no gap and no edge near."""

    def __init__(self, signals: JointSignals, gear_ratio: float, links: KnownLinks | None = None) -> None:
        """Motor shaft angles are divided by the gear ratio. `links`: what a robot description says of the torque."""
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
        self.links_known = links is not None
        for name, column in (("gravity", links.bias), ("inertia", links.inertia)) if links is not None else ():
            self._spectra[name] = self.spectral.transform(fill_gaps(column))
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
        """Columns of the links: acceleration, sine and cosine of the angle, one; and the torques of a description."""
        q = self.rows(self.position)
        known = [self.rows("gravity"), self.rows("inertia")] if self.links_known else []
        return [self.rows(self.position, 2), np.sin(q), np.cos(q), np.ones(q.size), *known]

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
class KnownLinks:
    """Rigid-body torque at one joint along a recording, from a robot description and the motion of all its joints, N m
    (n,): `inertia` of the accelerations, `bias` of gravity and velocities."""

    inertia: FloatArray
    bias: FloatArray


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


# ---- The shifts ------------------------------------------------------------------------------------


LONGEST_S, STEP_S = 0.1, 2e-3
"""Range and step of the search."""
SMALLEST = 2.0
"""Samples; a shorter delay is not worth a sentence."""
GAIN, REST = 0.85, 0.12
"""What may be left after the shift at most, of what was left before and of the signal."""
SURE = 3.0
"""Standard errors by which a delay must exceed `SMALLEST`."""
POSITIONS, MOTION = ("motor_shaft_position", "joint_position"), "the motion"
LEAST_MOTION, FEWEST_LINES = 0.3, 6.0
"""rad, and lines in the spectra of speed and acceleration: on one sine a delay looks like friction."""


@dataclass(frozen=True)
class Shift:
    """The best shift of a signal in s (positive: it is late) with its standard error, and what is left there: over
    what is left without it (`gain`) and over the signal (`rest`). `inside`: it is no end of the search."""

    name: str
    seconds: float
    error: float
    gain: float
    rest: float
    inside: bool

    def long(self, period: float) -> bool:
        """True if the shift is surely more than `SMALLEST` samples."""
        return abs(self.seconds) > SMALLEST * period + SURE * self.error

    def counts(self, period: float) -> bool:
        """True if the data show that the signal is shifted by more than `SMALLEST` samples."""
        return self.long(period) and self.inside and self.gain < GAIN and self.rest < REST

    def why_not(self) -> str:
        """Why the data do not fix the shift; empty if they do."""
        if not self.inside:
            return f"no best shift within {1e3 * LONGEST_S:.0f} ms"
        return "" if self.rest < REST else f"the balance leaves {100.0 * self.rest:.0f} % of the signal"

    def words(self, period: float) -> str:
        """`gauge_torque 3.1 ms (3.1 samples) late`."""
        size, how = abs(self.seconds), "late" if self.seconds > 0.0 else "early"
        return f"{self.name} {1e3 * size:.3g} ms ({size / period:.1f} samples) {how}"


@dataclass(frozen=True)
class MeasuredDelay:
    """How late a signal is against another, or against the motion, s, with its 95 % interval. `determined`: the
    recording shows it; else `why_not`. `sure`: it is surely more than `SMALLEST` samples."""

    signal: str
    against: str
    seconds: float
    low: float
    high: float
    determined: bool
    sure: bool
    why_not: str = ""

    @property
    def error(self) -> float:
        """What is not known of it, s."""
        return 0.5 * (self.high - self.low)

    def json(self) -> dict[str, Any]:
        """The form of `delays` in `hd.compare/1`."""
        return vars(self)


def measured_delays(rows: SlowRows) -> list[MeasuredDelay]:
    """The delay of every signal that another one, or the motion, can be compared with. Positive: it is late."""
    motion = _why_no_delay(rows)
    found = []
    for shift, against in (*position_shift(rows), *((shift, MOTION) for shift in _torque_shifts(rows))):
        slack = 2.0 * shift.error + (0.0 if shift.name in POSITIONS else rows.period)
        why = motion or shift.why_not()
        low, high = shift.seconds - slack, shift.seconds + slack
        sure = not why and shift.counts(rows.period)
        found.append(MeasuredDelay(shift.name, against, shift.seconds, low, high, not why, sure, why))
    return found


def delay_sentences(rows: SlowRows) -> list[str]:
    """Signals that come late or early by more than two samples, with the amount."""
    return [] if _why_no_delay(rows) else _between_positions(rows) or _of_torques(rows)


def _why_no_delay(rows: SlowRows) -> str:
    """Why the motion shows no delay; empty if it does."""
    span = float(np.ptp(rows.rows(rows.position)[rows.usable]))
    if span < LEAST_MOTION:
        return f"the joint moves by {span:.2g} rad only"
    lines = _lines(rows)
    return "" if lines >= FEWEST_LINES else f"the motion has {lines:.1f} frequencies only, a delay looks like friction"


def _lines(rows: SlowRows) -> float:
    """Effective number of spectral lines of speed or acceleration, whichever has fewer."""
    found = []
    for derivative in (1, 2):
        motion = rows.rows(rows.position, derivative) * rows.usable
        power = np.abs(np.fft.rfft(motion * np.hanning(motion.size))) ** 2
        found.append(float(power.sum() ** 2 / max(1e-300, float((power**2).sum()))))
    return min(found)


def _between_positions(rows: SlowRows) -> list[str]:
    return [_sentence(shift.words(rows.period), f"against {against}") for shift, against in position_shift(rows)
            if shift.counts(rows.period)]  # fmt: skip


def position_shift(rows: SlowRows) -> list[tuple[Shift, str]]:
    """The shift between the positions, if both are there."""
    if not {*POSITIONS} <= rows.present:
        return []
    torque = (
        [rows.rows("gauge_torque"), rows.rows("gauge_torque", 1)] if "gauge_torque" in rows.present else rows.link()
    )
    columns = [*torque, np.ones(rows.usable.size)]
    shift = best_shift(rows, "joint_position", columns, minus=rows.rows("motor_shaft_position"))
    return [(shift, "motor_shaft_position")]


def _torque_shifts(rows: SlowRows) -> list[Shift]:
    """Shifts of the torques, the one that explains most first."""
    names = [name for name in ("motor_torque", "gauge_torque") if name in rows.present]
    one, motion = np.ones(rows.usable.size), [rows.rows(rows.position, 2), *rows.friction()]
    if len(names) < 2:
        columns = [*rows.link(), *rows.friction()]
        shifts = [best_shift(rows, name, columns) for name in names]
    else:
        shifts = [best_shift(rows, name, [rows.rows(other), *motion, one]) for name, other in (names, names[::-1])]
    return sorted(shifts, key=lambda shift: shift.gain)


def _of_torques(rows: SlowRows) -> list[str]:
    shifts = _torque_shifts(rows)
    # A late motor torque and an early gauge often explain the same: then both are said, or none if one is short.
    close = [shift for shift in shifts if shift.gain < 1.25 * shifts[0].gain]
    if not shifts or not shifts[0].counts(rows.period) or not all(shift.long(rows.period) for shift in close):
        return []
    likely = [shift for shift in close if shift.counts(rows.period)]
    return [_sentence(" or ".join(shift.words(rows.period) for shift in likely), f"against {MOTION}")]


def _sentence(what: str, against: str) -> str:
    return f"shifted in time: {what} {against}; a delay between the signals, or of the drive"


def best_shift(rows: SlowRows, name: str, columns: Sequence[FloatArray], minus: FloatArray | None = None) -> Shift:
    """The shift at which the columns (rows,) explain the signal (less `minus`) best, refined by a parabola."""
    basis, _ = np.linalg.qr(np.column_stack(columns)[rows.usable])
    step = max(STEP_S, rows.period)
    count = int(LONGEST_S / step)
    shifts = step * np.arange(-count, count + 1)

    def left(shift: float) -> float:
        y = rows.rows(name, 0, shift)[rows.usable]
        y = y if minus is None else y - minus[rows.usable]
        return float(np.sum((y - basis @ (basis.T @ y)) ** 2))

    squares = np.array([left(float(shift)) for shift in shifts])
    best = int(np.argmin(squares))
    inside = 0 < best < squares.size - 1
    seconds = float(shifts[best])
    if inside:
        before, here, after = squares[best - 1 : best + 2]
        seconds += 0.5 * step * float((before - after) / max(1e-300, before - 2.0 * here + after))
    y, slope = rows.rows(name, 0, seconds), rows.rows(name, 1, seconds)
    fit = regress(y if minus is None else y - minus, [slope, *columns], rows.usable)
    gain = fit.rest / max(1e-300, float(np.sqrt(squares[count] / rows.usable.sum())))
    rest = fit.rest / max(1e-300, float(rows.rows(name)[rows.usable].std()))
    return Shift(name, seconds, fit.error(0), gain, 0.0 if minus is not None else rest, inside)


# ---- Delays that are taken out ---------------------------------------------------------------------


def carried(delays: Sequence[MeasuredDelay]) -> tuple[dict[str, float], tuple[str, ...]]:
    """Delays s by signal that a fit takes out of the signals, and words for them.

    Only sure ones, and of two torques none, for perhaps only one is late. A motor torque that comes early is a drive
    that answers late: that is an effect of the drive, and stays in.
    """
    sure = [delay for delay in delays if delay.sure]
    torques = [delay for delay in sure if delay.against == MOTION]
    chosen = [delay for delay in sure if delay.against != MOTION]
    if len(torques) == 1 and (torques[0].signal != "motor_torque" or torques[0].seconds > 0.0):
        chosen += torques
    words = tuple(
        f"{d.signal} taken {1e3 * abs(d.seconds):.3g} ms {'earlier' if d.seconds > 0.0 else 'later'}, as measured"
        for d in chosen
    )
    return {delay.signal: delay.seconds for delay in chosen}, words


def in_time(signals: JointSignals, delays: Mapping[str, float]) -> JointSignals:
    """The signals with some of them read `delays` s later; what lies beyond the recording is missing (NaN)."""
    from scipy.interpolate import CubicSpline

    columns: dict[str, Any] = {}
    valid = signals.valid
    for name, late in delays.items():
        column, at = getattr(signals, name), signals.time + late
        moved = CubicSpline(signals.time, fill_gaps(column))(at)
        index = np.clip(np.round(at / signals.period).astype(np.int64), 0, at.size - 1)
        bad = ~np.isfinite(column)[index] | (at < signals.time[0]) | (at > signals.time[-1])
        columns[name], valid = np.where(bad, np.nan, moved), valid & ~bad
    return replace(signals, valid=valid, **columns)
