"""One even time base for all signals of a recording, and the way of a topic onto it."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.errors import BagError

LONGEST_BRIDGE = 3
"""Missing samples that are filled; a longer gap stays NaN."""
EVEN = 1e-3
"""Largest distance of a stamp from the even grid, in periods, that counts as even."""
BACK_S = 0.2
"""s by which a clock must go back, and stay, to be another one; less is an order that got lost on the way."""
SLOWEST = 10.0
"""A signal recorded at less than 1 / SLOWEST of the dominating rate is not interpolated."""
FEWEST = 10
EMPTIEST = 10
"""A time base with more than this many ticks per sample loses its stretch beyond the largest gap."""
NS = 1_000_000_000


@dataclass(frozen=True)
class TimeBase:
    """`count` ticks `period` s apart from `start_ns` on; `even`: the stamps it was made from lie on it.

    `jitter`: RMS distance of the stamps from their mean spacing, s.
    """

    start_ns: int
    period: float
    count: int
    even: bool
    jitter: float

    def ticks(self, stamps_ns: IntArray) -> FloatArray:
        """Stamps as real tick numbers from 0, (n,)."""
        return (stamps_ns - self.start_ns) / (self.period * NS)

    def window(self, start_s: float, seconds: float | None) -> TimeBase:
        """The ticks within [start_s, start_s + seconds). Raises BagError if there are none."""
        first = max(0, round(start_s / self.period))
        last = self.count if seconds is None else min(self.count, first + round(seconds / self.period))
        if last - first < FEWEST:
            length = self.count * self.period
            raise BagError(f"no samples from {start_s:g} s on; the recording is {length:.3f} s long")
        start = self.start_ns + round(first * self.period * NS)
        return TimeBase(start, self.period, last - first, self.even, self.jitter)


def rising(stamps_ns: IntArray) -> IntArray:
    """Indices of the longest strictly rising part of the stamps: the fewest samples are given up, (m,)."""
    if stamps_ns.size < 2 or bool((np.diff(stamps_ns) > 0).all()):
        return np.arange(stamps_ns.size)
    ends: list[int] = []
    places: list[int] = []
    before = np.full(stamps_ns.size, -1, np.int64)
    for index, stamp in enumerate(stamps_ns.tolist()):
        length = bisect_left(ends, stamp)
        before[index] = places[length - 1] if length else -1
        ends[length:] = [stamp] if length == len(ends) else [stamp, *ends[length + 1 :]]
        places[length:] = [index] if length == len(places) else [index, *places[length + 1 :]]
    chain = [places[-1]]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])


def one_clock(stamps_ns: IntArray) -> slice:
    """The longest part of stamps in the order of recording in which the clock never goes back by `BACK_S` or more.

    Two recordings in one file, or a clock that was set back: their samples must not be sorted into each other.
    """
    if stamps_ns.size < 2:
        return slice(0, stamps_ns.size)
    highest = np.maximum.accumulate(stamps_ns)
    cuts = np.flatnonzero(np.diff(stamps_ns) <= -round(BACK_S * NS)) + 1
    late = stamps_ns[cuts] <= highest[cuts - 1] - round(BACK_S * NS)
    stays = np.array([_stays_back(stamps_ns, int(cut)) for cut in cuts], dtype=bool)
    edges = np.concatenate([[0], cuts[late & stays], [stamps_ns.size]])
    longest = int(np.argmax(np.diff(edges)))
    return slice(int(edges[longest]), int(edges[longest + 1]))


def _stays_back(stamps_ns: IntArray, cut: int) -> bool:
    """Does the clock go on from where it went back to? A single stray stamp does not."""
    after = stamps_ns[cut : cut + FEWEST]
    return after.size == FEWEST and bool((after < stamps_ns[cut - 1]).sum() > FEWEST // 2)


def period_of(stamps_ns: IntArray) -> float:
    """Spacing of rising stamps, s: the median, or the mean of the steps near it where they scatter or are rounded."""
    steps = np.diff(stamps_ns)
    if steps.size == 0:
        return np.inf
    median = float(np.median(steps))
    single = steps[(steps > 0.5 * median) & (steps < 1.5 * median)]
    equal = single.size == 0 or bool((single == single[0]).all())
    return (median if equal else float(single.mean())) / NS


def time_base(stamps_ns: IntArray, where: str) -> TimeBase:
    """The even base of rising stamps. Raises BagError if there are too few of them."""
    if stamps_ns.size < FEWEST:
        raise BagError(f"{where}: {stamps_ns.size} usable samples, at least {FEWEST} are needed")
    period = period_of(stamps_ns)
    ticks = (stamps_ns - stamps_ns[0]) / (period * NS)
    jitter = ticks - np.round(ticks)
    even = float(np.abs(jitter).max()) <= 2.0 * EVEN
    steps = np.diff(stamps_ns) / NS
    single = steps[steps < 1.5 * period]
    return TimeBase(int(stamps_ns[0]), period, round(float(ticks[-1])) + 1, even, float(np.std(single)))


def longest_stretch(stamps_ns: IntArray) -> slice:
    """The part of rising stamps that stays when a clock jumped: not more than `EMPTIEST` ticks per sample."""
    first, last = 0, stamps_ns.size
    step = max(1.0, period_of(stamps_ns) * NS)
    while last - first > 1 and stamps_ns[last - 1] - stamps_ns[first] > EMPTIEST * (last - first) * step:
        cut = first + 1 + int(np.argmax(np.diff(stamps_ns[first:last])))
        first, last = (first, cut) if cut - first >= last - cut else (cut, last)
    return slice(first, last)


class Alignment:
    """The way of one topic's samples onto a time base; made once, used for each of its columns."""

    def __init__(self, base: TimeBase, stamps_ns: IntArray, late_ns: int = 0) -> None:
        """`stamps_ns` (n,) rising; `late_ns` is taken off them."""
        self.base, self.ticks = base, base.ticks(stamps_ns - late_ns)
        self.spacing = period_of(stamps_ns) / base.period
        distance = np.abs(self.ticks - np.round(self.ticks)) if base.even else np.array([1.0])
        self.on_grid = self.spacing < 1.5 and float(distance.max(initial=0.0)) <= 5.0 * EVEN

    def column(self, values: FloatArray, held: bool) -> FloatArray:
        """Values (n,) at the stamps -> (count,), NaN inside gaps of more than `LONGEST_BRIDGE` samples.

        A `held` value is the mean over the tick of what is held; other values are interpolated by a cubic spline.
        """
        finite = np.isfinite(values)
        ticks, values = (self.ticks, values) if finite.all() else (self.ticks[finite], values[finite])
        found = np.full(self.base.count, np.nan)
        if ticks.size < 2:
            return found
        if self.on_grid:
            place = np.round(ticks).astype(np.int64)
            inside = (place >= 0) & (place < self.base.count)
            if inside.all():
                found[place] = values
            else:
                found[place[inside]] = values[inside]
            missing = np.flatnonzero(np.isnan(found))
        else:
            missing = np.arange(self.base.count)
        if missing.size:
            found[missing] = self._between(ticks, values, missing, held)
        return found

    def slow_column(self, values: FloatArray) -> FloatArray:
        """Values (n,) of something slow -> (count,): straight lines, the ends held."""
        finite = np.isfinite(values)
        if not finite.any():
            return np.full(self.base.count, np.nan)
        return np.interp(np.arange(self.base.count), self.ticks[finite], values[finite])

    def _between(self, ticks: FloatArray, values: FloatArray, wanted: IntArray, held: bool) -> FloatArray:
        """The signal at wanted ticks; NaN where the samples around one are too far apart."""
        after = np.searchsorted(ticks, wanted, side="right")
        low, high = np.maximum(after - 1, 0), np.minimum(after, ticks.size - 1)
        slack = 0.5 * max(1.0, self.spacing)
        reach = (LONGEST_BRIDGE + 1) * max(1.0, self.spacing) + slack
        near = ((ticks[high] - ticks[low]) < reach) & (wanted >= ticks[0] - slack) & (wanted <= ticks[-1] + slack)
        found = np.full(wanted.size, np.nan)
        if not near.any():
            return found
        if held:
            found[near] = _held_mean(ticks, values, wanted[near])
        else:
            from scipy.interpolate import CubicSpline

            found[near] = CubicSpline(ticks, values)(np.clip(wanted[near], ticks[0], ticks[-1]))
        return found


def _held_mean(ticks: FloatArray, values: FloatArray, wanted: IntArray) -> FloatArray:
    """Mean over [wanted, wanted + 1) of a value that is held from each tick to the next."""
    knots = np.append(ticks, max(ticks[-1], float(wanted[-1])) + 2.0)
    area = np.concatenate([[0.0], np.cumsum(values * np.diff(knots))])
    first = np.maximum(wanted, ticks[0])
    mean: FloatArray = np.interp(first + 1.0, knots, area) - np.interp(first, knots, area)
    return mean
