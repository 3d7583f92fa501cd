"""Order spectrum: amplitude of a residual or torque over cycles per turn; the lines that stand out of it, with names.

The signal is averaged over cells of equal angle, so that a line keeps its order while the speed changes. Passes of one
direction are cut into stretches of equal angle, windowed (Hann) and averaged in power; both directions stay apart. An
order is judged only at speeds at which its frequency lies inside the band of the channel.

A line is bound to the angle only if its order stays put while the speed changes; a line fixed in hertz is a resonance
or a disturbance. Orders closer than the resolution 1 / turns are not separable: all their names are listed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.lab.balances.channels import JointEquations

FORWARD, BACKWARD = 1, -1
CELLS_PER_CYCLE = 8
PADDING = 2
SPAN = 2.0**0.5
"""Highest over lowest order of a part of the spectrum; each part uses the speeds at which it lies inside the band."""
MARGINS = (1.25, 1.5, 2.0, 3.0)
"""A part is computed beyond its upper end, for the floor there: by the first factor that holds enough cells."""
LEAST_CYCLES = 10
"""Cycles of the lowest order of a part in a stretch."""
LONGEST_TURNS = 2000.0
FLOOR_CELLS, LEAST_CELLS, GUARD_CELLS = 12, 5, 2
"""Resolution cells on each side that make the local floor, at most and at least; cells next to a line that do not."""
LINE_FACTOR = 5.0
"""A line is this much above the local median floor."""
WAVE_GENERATOR, JOINT = "wave-generator turn", "joint turn"


@dataclass(frozen=True)
class OrderRecord:
    """One recording: `time` s and `turns` of the shaft that orders count (rows,); `values` (rows,) of one signal, or
    (rows, k) of several; rows that are `used`; `band` Hz up to which the values are not attenuated."""

    time: FloatArray
    turns: FloatArray
    values: FloatArray
    used: BoolArray
    band: float

    @cached_property
    def rate(self) -> FloatArray:
        """Turns per s, (rows,)."""
        return np.asarray(np.gradient(self.turns, self.time))


@dataclass(frozen=True)
class Stretch:
    """One windowed stretch: direction, mean speed in turns/s, power of its amplitude (orders,)."""

    direction: int
    speed: float
    power: FloatArray


@dataclass(frozen=True)
class Part:
    """The stretches of one part of the spectrum: `orders` (k,) with margins, limits, `turns` of each stretch."""

    orders: FloatArray
    low: float
    high: float
    turns: float
    stretches: tuple[Stretch, ...]

    @property
    def resolution(self) -> float:
        """Distance of two orders that are separable: 1 / turns."""
        return 1.0 / self.turns

    def holds(self, order: float) -> bool:
        """Does an order belong to this part, a resolution cell at its ends included?"""
        return self.low - self.resolution <= order < self.high + self.resolution

    def amplitude(self, stretches: Iterable[Stretch]) -> FloatArray:
        """Amplitude (k,) of some stretches, averaged in power; NaN if there are none."""
        powers = [s.power for s in stretches]
        return np.sqrt(np.mean(powers, axis=0)) if powers else np.full(self.orders.size, np.nan)

    def floor(self, amplitude: FloatArray) -> FloatArray:
        """Local floor (k,): the larger median of both sides, so that a slope is no line; NaN without both sides."""
        return local_floor(amplitude, round(self.resolution / float(self.orders[1] - self.orders[0])))


@dataclass(frozen=True)
class DirectionSpectrum:
    """Spectrum of one direction: orders per `OrderSpectrum.turn`, amplitude, floor (k,), number of stretches (k,)."""

    orders: FloatArray
    amplitude: FloatArray
    floor: FloatArray
    stretches: FloatArray


@dataclass(frozen=True)
class Peak:
    """A line of one direction: order, amplitude in the unit of the values, local floor, resolution in orders."""

    direction: int
    order: float
    amplitude: float
    floor: float
    resolution: float
    part: Part = field(repr=False)


@dataclass(frozen=True)
class OrderSpectrum:
    """Both directions of a signal. `turn`: what orders count; `gear_ratio` wave-generator turns per joint turn, None if
    not known; `peaks` above `LINE_FACTOR` x floor."""

    turn: str
    gear_ratio: float | None
    directions: dict[int, DirectionSpectrum]
    parts: tuple[Part, ...]
    peaks: tuple[Peak, ...]

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest order that could be judged; NaN if none."""
        if not self.parts:
            return float("nan"), float("nan")
        return min(o.low for o in self.parts), max(o.high for o in self.parts)


def channel_record(equations: JointEquations, channel: str, residual: FloatArray, used: BoolArray) -> OrderRecord:
    """The record of a channel's residual (rows,) over turns of the wave generator; of the joint if the model's gear
    ratio is 1, which stands for an unknown one."""
    part = equations.channels[channel]
    turns = equations.states.motor_shaft_position[:: part.band.step] / (2.0 * np.pi)
    return OrderRecord(part.time, turns, residual, used, part.band.flat)


def order_spectrum(
    records: Sequence[OrderRecord], gear_ratio: float | None, least: float = 0.6, most: float = 40.0
) -> OrderSpectrum:
    """Spectrum of one signal over all `records` together. With a gear ratio, turns are the wave generator's; without,
    the joint's. `least`, `most`: range of orders in that unit."""
    return order_spectra(records, gear_ratio, least, most)[0]


def order_spectra(
    records: Sequence[OrderRecord], gear_ratio: float | None, least: float = 0.6, most: float = 40.0
) -> tuple[OrderSpectrum, ...]:
    """The same of several signals that were recorded together, for little more than one of them."""
    signals = 1 if records[0].values.ndim == 1 else records[0].values.shape[1]
    parts: list[tuple[Part, ...]] = []
    low = least
    while low < most:
        high = min(SPAN * low, most)
        part = _part(records, low, high)
        if part is not None:
            parts.append(part)
        low = high
    turn = JOINT if gear_ratio is None else WAVE_GENERATOR
    return tuple(_spectrum([part[i] for part in parts], turn, gear_ratio) for i in range(signals))


def _spectrum(parts: Sequence[Part], turn: str, gear_ratio: float | None) -> OrderSpectrum:
    directions = {d: _joined(parts, d) for d in (BACKWARD, FORWARD)}
    peaks = [peak for part in parts for d in (BACKWARD, FORWARD) for peak in _peaks(part, d)]
    return OrderSpectrum(turn, gear_ratio, directions, tuple(parts), tuple(sorted(peaks, key=lambda p: p.order)))


@dataclass(frozen=True)
class _Run:
    """Rows of one record that move one way without a break and inside the band."""

    record: OrderRecord
    rows: slice
    direction: int

    @property
    def turns(self) -> float:
        """Turns of the run, which goes one way."""
        return abs(float(self.record.turns[self.rows.stop - 1] - self.record.turns[self.rows.start]))


def _runs(record: OrderRecord, highest: float) -> list[_Run]:
    """Runs in which `highest` orders per turn stay inside the band."""
    rate = record.rate
    inside = record.used & (np.abs(rate) * highest <= record.band)
    state = np.where(inside, np.sign(rate), 0.0).astype(np.int64)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(state)) + 1, [state.size]])
    long = np.flatnonzero((np.diff(edges) >= 8) & (state[edges[:-1]] != 0))
    return [_Run(record, slice(int(edges[i]), int(edges[i + 1])), int(state[edges[i]])) for i in long]


def _part(records: Sequence[OrderRecord], low: float, high: float) -> tuple[Part, ...] | None:
    """The part of every signal."""
    cells = LEAST_CELLS + GUARD_CELLS + 1
    for margin in MARGINS:
        runs = [run for record in records for run in _runs(record, margin * high)]
        turns = _stretch_turns([run.turns for run in runs], LEAST_CYCLES / low)
        if turns is not None and (margin - 1.0) * high * turns >= cells:
            return _spectra(runs, turns, low, high, margin * high)
    return None


def _spectra(runs: Sequence[_Run], turns: float, low: float, high: float, highest: float) -> tuple[Part, ...]:
    """The stretches of `turns` turns of all runs, for every signal."""
    cells = int(np.ceil(turns * highest * CELLS_PER_CYCLE))
    all_orders = np.asarray(np.fft.rfftfreq(PADDING * cells, turns / cells), dtype=np.float64)
    keep = (all_orders >= max(3.0 / turns, 0.25 * low)) & (all_orders <= highest)
    orders = all_orders[keep]
    stretches = [s for run in runs if run.turns >= turns for s in _stretches(run, turns, cells, keep, orders)]
    return tuple(Part(orders, low, high, turns, own) for own in zip(*stretches, strict=True))


def _stretch_turns(lengths: list[float], least: float) -> float | None:
    """The longest stretch that still uses half of all turns; None if none holds `least` turns."""
    usable = sorted((min(x, LONGEST_TURNS) for x in lengths if x >= least), reverse=True)
    total = sum(min(x, LONGEST_TURNS) for x in lengths)
    best = None
    for count, turns in enumerate(usable, 1):
        best = turns
        if count * turns >= 0.5 * total:
            break
    return best


def _stretches(
    run: _Run, turns: float, cells: int, keep: BoolArray, orders: FloatArray
) -> list[tuple[Stretch, ...]]:  # fmt: skip
    """Spectra of the stretches of a run, overlapping by half; one for every signal."""
    from scipy.interpolate import CubicSpline

    rows = run.rows
    time, rate = run.record.time[rows], run.record.rate[rows]
    values = run.record.values[rows].reshape(time.size, -1)
    angle = np.maximum.accumulate(run.direction * (run.record.turns[rows] - run.record.turns[rows.start]))
    forward = np.concatenate([[True], np.diff(angle) > 0.0])
    swept = CubicSpline(time, np.column_stack([rate, values * rate[:, None]])).antiderivative()
    window = np.hanning(cells + 2)[1:-1]
    damping = np.sinc(orders * turns / cells)
    position = np.linspace(-0.5, 0.5, cells)
    position = position / (position @ position)
    count = 1 + int(np.floor(2.0 * (angle[-1] / turns - 1.0) + 1e-9))
    found = []
    for k in range(max(1, count)):
        edges = np.linspace(0.0, turns, cells + 1) + 0.5 * k * turns
        moments = np.interp(edges, angle[forward], time[forward])
        area = np.diff(swept(moments), axis=0) * run.direction
        mean = (area[:, 1:] / np.maximum(area[:, :1], 1e-12)).T
        mean = mean - mean.mean(axis=1, keepdims=True)
        mean = mean - (mean @ np.linspace(-0.5, 0.5, cells))[:, None] * position
        amplitude = 2.0 * np.abs(np.fft.rfft(mean * window, PADDING * cells))[:, keep] / window.sum() / damping
        speed = turns / max(float(moments[-1] - moments[0]), 1e-12)
        found.append(tuple(Stretch(run.direction, speed, own**2) for own in amplitude))
    return found


def local_floor(amplitude: FloatArray, cell: int) -> FloatArray:
    """Larger of the medians of both sides (k,), `cell` bins per resolution cell; NaN where one side is too short."""
    from numpy.lib.stride_tricks import sliding_window_view

    width, guard, k = FLOOR_CELLS * cell, GUARD_CELLS * cell, amplitude.size
    if not np.isfinite(amplitude).all():
        return np.full(k, np.nan)
    padded = np.pad(amplitude, width + guard, constant_values=np.nan)
    windows = sliding_window_view(padded, width)
    filled = np.flatnonzero(np.isfinite(windows).sum(axis=1) >= LEAST_CELLS * cell)
    medians = np.full(len(windows), np.nan)
    medians[filled] = np.nanmedian(windows[filled], axis=1)
    return np.asarray(np.maximum(medians[:k], medians[2 * guard + width + 1 :][:k]))


def _joined(parts: Sequence[Part], direction: int) -> DirectionSpectrum:
    columns: list[tuple[FloatArray, ...]] = [(np.zeros(0),) * 4]
    for part in parts:
        mine = [s for s in part.stretches if s.direction == direction]
        amplitude = part.amplitude(mine)
        keep = (part.orders >= part.low) & (part.orders < part.high)
        count = np.full(part.orders.size, float(len(mine)))
        columns.append(tuple(x[keep] for x in (part.orders, amplitude, part.floor(amplitude), count)))
    return DirectionSpectrum(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _peaks(part: Part, direction: int) -> list[Peak]:
    amplitude = part.amplitude(s for s in part.stretches if s.direction == direction)
    floor = part.floor(amplitude)
    found = []
    with np.errstate(invalid="ignore"):
        above = np.flatnonzero(amplitude > LINE_FACTOR * floor)
    for i in above:
        near = slice(max(0, i - GUARD_CELLS * PADDING), i + GUARD_CELLS * PADDING + 1)
        if part.holds(float(part.orders[i])) and amplitude[i] >= amplitude[near].max():
            order, height = _summit(part.orders, amplitude, int(i))
            found.append(Peak(direction, order, height, float(floor[i]), part.resolution, part))
    return found


def _summit(orders: FloatArray, amplitude: FloatArray, i: int) -> tuple[float, float]:
    """Order and height of a peak, by a parabola through the logarithms of three bins."""
    if not 0 < i < orders.size - 1:
        return float(orders[i]), float(amplitude[i])
    a, b, c = np.log(amplitude[i - 1 : i + 2])
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend < 0.0 else 0.0
    return float(orders[i] + shift * (orders[1] - orders[0])), float(np.exp(b - 0.25 * (a - c) * shift))


# ---- Lines: names, and whether they are bound to the angle or to time ------------------------------


ANGLE, HERTZ, ONE_SPEED, OPEN = "angle", "hertz", "one speed", "open"
SPEED_RATIO = 1.25
"""Mean speed of the fast over that of the slow stretches from which on angle and time are separable."""
SPEED_LIKE = 1.1
"""Speeds that differ by less count as the same."""
PRESENT = 3.0
"""Times the floor at which a line that was found counts as seen in a part of the recording."""
NEAR = 0.15
"""Orders by which a line may miss its name, however coarse the resolution is."""
HARMONIC = "kinematic error or gauge ripple"
COGGING = "cogging (poles or slots)"
TURNING_GAUGE = "gauge that turns with the joint"
ECCENTRICITY = "eccentricity"


@dataclass(frozen=True)
class OrderLine:
    """A line: `order` per turn of the spectrum's axis; `amplitude` and `floor` of the direction where it is largest;
    `directions` in which it stands out; `names`, nearest first, all that the resolution allows; `bound` to angle,
    hertz, or not decided (one speed, open)."""

    order: float
    amplitude: float
    floor: float
    resolution: float
    directions: tuple[int, ...]
    names: tuple[str, ...]
    bound: str

    @property
    def ratio(self) -> float:
        """Amplitude over floor."""
        return self.amplitude / self.floor


def lines_of(spectrum: OrderSpectrum) -> tuple[OrderLine, ...]:
    """The lines of both directions, those at the same order joined, largest over its floor first."""
    left = sorted(spectrum.peaks, key=lambda peak: -peak.amplitude / peak.floor)
    found = []
    while left:
        first = left[0]
        same = [peak for peak in left if abs(peak.order - first.order) <= max(first.resolution, peak.resolution)]
        left = [peak for peak in left if peak not in same]
        directions = tuple(sorted({peak.direction for peak in same}))
        bound = binding(first, spectrum.parts)
        names = names_of(first.order, first.resolution, spectrum.gear_ratio) if bound != HERTZ else ()
        found.append(OrderLine(first.order, first.amplitude, first.floor, first.resolution, directions, names, bound))
    return tuple(found)


def binding(peak: Peak, parts: Sequence[Part]) -> str:
    """`angle`: the order is the same at low and at high speed; `hertz`: the frequency is; else why it is not known."""
    mine = sorted((s for s in peak.part.stretches if s.direction == peak.direction), key=lambda s: s.speed)
    slow, fast = _split(mine)
    if not slow or not fast:
        return ONE_SPEED
    low, high = (float(np.mean([s.speed for s in group])) for group in (slow, fast))
    if high < SPEED_RATIO * low:
        return ONE_SPEED
    seen = [_present(peak.part, group, peak.order) for group in (slow, fast)]
    if all(seen):
        return ANGLE
    for here, there, order in ((0, fast, peak.order * low / high), (1, slow, peak.order * high / low)):
        if seen[here] and any(_present(part, _like(part, there), order) for part in parts if part.holds(order)):
            return HERTZ
    return OPEN


def _like(part: Part, group: Sequence[Stretch]) -> list[Stretch]:
    """The stretches of another part that have the direction and the speeds of a group."""
    speeds = [s.speed for s in group]
    low, high = min(speeds) / SPEED_LIKE, max(speeds) * SPEED_LIKE
    return [s for s in part.stretches if s.direction == group[0].direction and low <= s.speed <= high]


def _split(stretches: Sequence[Stretch]) -> tuple[Sequence[Stretch], Sequence[Stretch]]:
    """Slow and fast, at the widest step between neighbouring speeds in the middle half."""
    if len(stretches) < 2:
        return (), ()
    speeds = np.array([s.speed for s in stretches])
    first, last = (len(stretches) - 1) // 4, len(stretches) - 1 - (len(stretches) - 1) // 4
    cut = first + 1 + int(np.argmax(np.diff(np.log(speeds))[first:last]))
    return stretches[:cut], stretches[cut:]


def _present(part: Part, stretches: Sequence[Stretch], order: float) -> bool:
    """Does a part of the recording show a line at this order, within the resolution?"""
    amplitude = part.amplitude(stretches)
    floor = part.floor(amplitude)
    near = np.abs(part.orders - order) <= part.resolution
    with np.errstate(invalid="ignore"):
        return bool(np.any(amplitude[near] > PRESENT * floor[near]))


def names_of(order: float, resolution: float, gear_ratio: float | None) -> tuple[str, ...]:
    """Names of an order per wave-generator turn (per joint turn if the ratio is None), nearest first."""
    if gear_ratio is None:
        low, high = 0.5 * (order - resolution), 0.5 * (order + resolution)
        return (f"if it is 2 per wave-generator turn, the gear ratio is {low:.0f} to {high:.0f}",)
    found = [(n / gear_ratio, f"{n} per joint turn: {ECCENTRICITY}") for n in (1, 2)]
    whole = round(order)
    if whole >= 1:
        cause = HARMONIC if whole in (1, 2, 4) else COGGING
        found.append((float(whole), f"{whole} per wave-generator turn: {cause}"))
    if whole >= 2 and whole % 2 == 0:
        for sign in (-1, 1):
            turns = whole * (gear_ratio + sign)
            found.append((turns / gear_ratio, f"{whole}(N{sign:+d}) = {turns:g} per joint turn: {TURNING_GAUGE}"))
    near = [(abs(order - place), name) for place, name in found if abs(order - place) <= min(resolution, NEAR)]
    return tuple(name for _, name in sorted(near))


def describe(line: OrderLine, spectrum: OrderSpectrum, unit: str, factor: float = 1.0) -> str:
    """A line in one sentence; `unit` is that of the amplitude times `factor`."""
    where = f"{line.order:.4g} per {spectrum.turn}"
    if spectrum.gear_ratio is not None:
        joint = line.order * spectrum.gear_ratio
        where += f" ({joint:.4g} +- {0.5 * line.resolution * spectrum.gear_ratio:.2g} per joint turn)"
    both = {(BACKWARD, FORWARD): "in both directions", (FORWARD,): "forward only", (BACKWARD,): "backward only"}
    text = f"{where}: {factor * line.amplitude:.3g} {unit}, {line.ratio:.0f} times the floor, {both[line.directions]}"
    why = {
        ANGLE: "stays at its order while the speed changes",
        HERTZ: "stays at its frequency in hertz: a resonance or disturbance, not bound to the angle",
        ONE_SPEED: "seen at one speed only, so angle and time are not separable",
        OPEN: "not seen at every speed",
    }
    names = "; or ".join(line.names) or ("" if line.bound == HERTZ else "no known order")
    return f"{text}; {why[line.bound]}" + (f"; {names}" if names else "")
