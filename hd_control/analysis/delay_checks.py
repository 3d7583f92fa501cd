"""Delays between a joint's signals: the shift in time with which the balances fit best.

    q(t + D) - phi = tau_s / k + ...
    u(t + D) = tau_s + I phi'' + friction
    tau_s(t + D) = J q'' + g(q) + friction

The shift is exact (in the frequency domain); what is left at each shift follows from one projection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.slow_rows import SlowRows, regress
from hd_control.core.arrays import FloatArray

LONGEST_S, STEP_S = 0.1, 2e-3
"""Range and step of the search."""
SMALLEST = 2.0
"""Samples; a shorter delay is not worth a sentence."""
GAIN, REST = 0.85, 0.12
"""What may be left after the shift at most, of what was left before and of the signal."""
SURE = 3.0
"""Standard errors by which a delay must exceed `SMALLEST`."""
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

    def words(self, period: float) -> str:
        """`gauge_torque 3.1 ms (3.1 samples) late`."""
        size, how = abs(self.seconds), "late" if self.seconds > 0.0 else "early"
        return f"{self.name} {1e3 * size:.3g} ms ({size / period:.1f} samples) {how}"


def delay_sentences(rows: SlowRows) -> list[str]:
    """Signals that come late or early by more than two samples, with the amount."""
    if float(np.ptp(rows.rows(rows.position)[rows.usable])) < LEAST_MOTION or _lines(rows) < FEWEST_LINES:
        return []
    return _between_positions(rows) or _of_torques(rows)


def _lines(rows: SlowRows) -> float:
    """Effective number of spectral lines of speed or acceleration, whichever has fewer."""
    found = []
    for derivative in (1, 2):
        motion = rows.rows(rows.position, derivative) * rows.usable
        power = np.abs(np.fft.rfft(motion * np.hanning(motion.size))) ** 2
        found.append(float(power.sum() ** 2 / max(1e-300, float((power**2).sum()))))
    return min(found)


def _between_positions(rows: SlowRows) -> list[str]:
    if not {"motor_shaft_position", "joint_position"} <= rows.present:
        return []
    torque = (
        [rows.rows("gauge_torque"), rows.rows("gauge_torque", 1)] if "gauge_torque" in rows.present else rows.link()
    )
    columns = [*torque, np.ones(rows.usable.size)]
    shift = best_shift(rows, "joint_position", columns, minus=rows.rows("motor_shaft_position"))
    return [_sentence(shift.words(rows.period), "against motor_shaft_position")] if shift.counts(rows.period) else []


def _of_torques(rows: SlowRows) -> list[str]:
    names = [name for name in ("motor_torque", "gauge_torque") if name in rows.present]
    one, motion = np.ones(rows.usable.size), [rows.rows(rows.position, 2), *rows.friction()]
    if len(names) < 2:
        columns = [*rows.link(), *rows.friction()]
        shifts = [best_shift(rows, name, columns) for name in names]
    else:
        shifts = [best_shift(rows, name, [rows.rows(other), *motion, one]) for name, other in (names, names[::-1])]
    shifts.sort(key=lambda shift: shift.gain)
    # A late motor torque and an early gauge often explain the same: then both are said, or none if one is short.
    close = [shift for shift in shifts if shift.gain < 1.25 * shifts[0].gain]
    if not shifts or not shifts[0].counts(rows.period) or not all(shift.long(rows.period) for shift in close):
        return []
    likely = [shift for shift in close if shift.counts(rows.period)]
    return [_sentence(" or ".join(shift.words(rows.period) for shift in likely), "against the motion")]


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
