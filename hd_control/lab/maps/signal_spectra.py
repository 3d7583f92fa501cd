"""Spectra of the measured torques and of the torsion themselves, over turns and over time: no model stands in them.

    torsion = q - phi                 what gear and spring lose between motor and joint
    density P(f) of the signal        Welch, half overlapping Hann windows
    amplitude^2 = 2 integral (P - floor) df over a line       of a sine with the power that stands out

So an amplitude does not follow a guessed inertia or stiffness. Lines over turns are those of `orders`; a line over time
is kept if it is not an order at the speed that prevails.

Method: Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio 15 (1967).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.states import MOTOR_TAPER
from hd_control.lab.maps.orders import OrderLine, OrderRecord, OrderSpectrum, describe, lines_of, order_spectra
from hd_control.lab.signals.filters import Band, band_for
from hd_control.lab.signals.sensors import Segments

TORSION = "torsion"
WIDEST = (100.0, 150.0)
"""Hz, flat and zero, of the signals: what wave generators and arms make lies below."""
JOINT_ORDERS = (20.0, 1500.0)
"""Orders per joint turn that are looked at where the gear ratio is not known."""
PIECES = 8
"""Segments of a spectrum over time at least, without overlap."""
LOWEST_HZ = 3.0
"""Below it the motion itself is in every signal."""
CLEAR = 8.0
"""Power over the local floor from which on a peak is a line."""
ASIDE, WIDTH, GRID = 1.35, 1.2, 100
"""Ratio of frequency at which the local floor is read on each side, that over which it is a median, points of it."""
EDGE = 2.0
"""Times the floor at which a line ends."""
STEADY = 0.1
"""Relative spread of the speed up to which one speed prevails."""


@dataclass(frozen=True)
class HertzLine:
    """A line fixed in time: `frequency` and `width` Hz (full, at half of its power), `amplitude` of a sine of its power
    and of the floor under it, unit of the signal. `order`: it is that many per turn at the speed that prevails."""

    frequency: float
    width: float
    amplitude: float
    floor: float
    order: float | None = None


@dataclass(frozen=True)
class SignalSpectrum:
    """One measured signal: its order spectrum and lines; density (k,) over `frequency` Hz with its local floor, and the
    lines in it, largest over their floor first."""

    signal: str
    unit: str
    orders: OrderSpectrum
    lines: tuple[OrderLine, ...]
    frequency: FloatArray
    density: FloatArray
    floor: FloatArray
    hertz: tuple[HertzLine, ...]

    def json(self) -> dict[str, Any]:
        """The form of `spectra` in `hd.compare/1`."""
        ratio = self.orders.gear_ratio
        lines = [
            {
                "order": x.order,
                "per": self.orders.turn,
                "order_per_joint_turn": x.order * (1.0 if ratio is None else ratio),
                "resolution": x.resolution,
                "amplitude": x.amplitude,
                "floor": x.floor,
                "directions": list(x.directions),
                "bound_to": x.bound,
                "names": list(x.names),
            }
            for x in self.lines
        ]
        resonances = [vars(x) for x in self.hertz]
        return {"unit": self.unit, "order_lines": lines, "hertz_lines": resonances}

    def sentences(self, unit: str, factor: float = 1.0) -> list[str]:
        """One sentence for each line, in `unit` = own unit times `factor`."""
        return [*(describe(x, self.orders, unit, factor) for x in self.lines), *hertz_words(self.hertz, unit, factor)]


def hertz_words(lines: Sequence[HertzLine], unit: str, factor: float = 1.0) -> list[str]:
    """One sentence for each line over time."""
    found = []
    for x in lines:
        text = f"{x.frequency:.3g} Hz, {x.width:.2g} Hz wide: {factor * x.amplitude:.3g} {unit}"
        what = "a resonance or disturbance" if x.order is None else f"order {x.order:.4g} at the speed that prevails"
        found.append(f"{text}; {what}")
    return found


def signal_spectra(equations: JointEquations) -> tuple[SignalSpectrum, ...]:
    """Spectra of motor torque, gauge torque and torsion, of those that are measured."""
    s, filled = equations.states, equations.derived.filled
    signals: dict[str, FloatArray] = {name: filled[name] for name in ("motor_torque", "gauge_torque") if name in filled}
    if s.gear_ratio != 1.0 and not np.array_equal(filled["joint_position"], filled["motor_position"]):
        signals[TORSION] = filled["joint_position"] - filled["motor_position"]
    return _spectra(equations, signals) if signals else ()


def _spectra(equations: JointEquations, signals: Mapping[str, FloatArray]) -> tuple[SignalSpectrum, ...]:
    """Spectra of signals (n,) by name."""
    spectral, s = equations.spectral, equations.states
    band = band_for(spectral.period, *WIDEST)
    rows, time = spectral.filter(np.column_stack([*signals.values()]), band), s.time[:: band.step]
    slow = band_for(spectral.period, *MOTOR_TAPER)
    turns = spectral.filter(s.motor_shaft_position, Band(slow.flat, slow.zero, band.step)) / (2.0 * np.pi)
    d = equations.derived
    used, moving = d.usable[:: band.step], (np.abs(d.motor_velocity) >= d.speed_threshold)[:: band.step]
    record = OrderRecord(time, turns, rows, used & moving, band.flat)
    known = s.gear_ratio != 1.0  # 1 stands for a ratio that is not known
    orders = order_spectra([record], s.gear_ratio) if known else order_spectra([record], None, *JOINT_ORDERS)
    pace, found = prevailing(record.rate[used]), []
    for i, name in enumerate(signals):
        frequency, density = density_of(np.where(used, rows[:, i], np.nan), band.step * spectral.period, band.flat)
        floor = local_floor_of(frequency, density)
        lines, hertz = lines_of(orders[i]), hertz_lines(frequency, density, floor, pace)
        unit = "rad" if name == TORSION else "N m"
        found.append(SignalSpectrum(name, unit, orders[i], lines, frequency, density, floor, hertz))
    return tuple(found)


def density_of(rows: FloatArray, period: float, highest: float) -> tuple[FloatArray, FloatArray]:
    """Frequency Hz and one-sided density (unit^2/Hz) of rows (n,), NaN where they do not count; empty if too short."""
    segments = Segments.of([rows], period, PIECES)
    if segments is None:
        return np.zeros(0), np.zeros(0)
    keep = (segments.frequency >= 0.5 * LOWEST_HZ) & (segments.frequency <= highest)
    return segments.frequency[keep], segments.power(0)[keep]


def local_floor_of(frequency: FloatArray, density: FloatArray) -> FloatArray:
    """Larger of the medians on both sides (k,), so that a slope is no line; NaN where one side is missing.

    Medians over [f / `WIDTH`, f `WIDTH`] at `GRID` frequencies, straight lines between them; those of the two sides
    are read at f / `ASIDE` and f `ASIDE`.
    """
    if frequency.size < 2:
        return np.full(frequency.size, np.nan)
    centres = np.geomspace(frequency[0], frequency[-1], GRID)
    low, high = np.searchsorted(frequency, centres / WIDTH), np.searchsorted(frequency, centres * WIDTH, side="right")
    medians = np.array([np.median(density[a:b]) if b - a >= 3 else np.nan for a, b in zip(low, high, strict=True)])
    sides = (np.interp(frequency * x, centres, medians, np.nan, np.nan) for x in (1.0 / ASIDE, ASIDE))
    return np.asarray(np.maximum(*sides))


def hertz_lines(
    frequency: FloatArray, density: FloatArray, floor: FloatArray, pace: float | None = None
) -> tuple[HertzLine, ...]:
    """Peaks of a density (k,) above `CLEAR` x floor. `pace`: turns per s that prevail, None if none does."""
    if frequency.size < 3:
        return ()
    step, found, free = float(frequency[1] - frequency[0]), list[HertzLine](), frequency >= LOWEST_HZ
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(density / floor)
    for i in np.argsort(-ratio):
        if ratio[i] < CLEAR:
            break
        if not free[i]:
            continue
        low, high = _ends(ratio, int(i))
        free[max(0, low - 1) : high + 2] = False
        excess = np.maximum(density[low : high + 1] - floor[i], 0.0)
        power, centre = float(excess.sum()) * step, float(excess @ frequency[low : high + 1] / excess.sum())
        half = int((density[low : high + 1] - floor[i] >= 0.5 * (density[i] - floor[i])).sum())
        under = float(np.sqrt(2.0 * floor[i] * step * (high - low + 1)))
        found.append(HertzLine(centre, half * step, float(np.sqrt(2.0 * power)), under, _order(centre, step, pace)))
    return tuple(found)


def _ends(ratio: FloatArray, peak: int) -> tuple[int, int]:
    """First and last bin of a line."""
    low = high = peak
    while low > 0 and ratio[low - 1] > EDGE:
        low -= 1
    while high < ratio.size - 1 and ratio[high + 1] > EDGE:
        high += 1
    return low, high


def prevailing(rate: FloatArray) -> float | None:
    """Turns per s (n,) without sign, if most of the motion has one speed; else None."""
    speed = np.abs(rate)
    moving = speed[speed > 0.2 * float(np.quantile(speed, 0.9))] if speed.size else speed
    if not moving.size:
        return None
    low, middle, high = (float(x) for x in np.quantile(moving, [0.25, 0.5, 0.75]))
    return middle if middle > 0.0 and high - low < STEADY * middle else None


def _order(frequency: float, step: float, pace: float | None) -> float | None:
    """Whole order per turn that a frequency is at the speed that prevails; None if it is none."""
    if pace is None:
        return None
    order = round(frequency / pace)
    return float(order) if order >= 1 and abs(frequency - order * pace) <= max(1.5 * step, 0.02 * frequency) else None
