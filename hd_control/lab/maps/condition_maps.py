"""Where a residual is large: statistics over speed, load, angles, reversals, temperature and time; one sentence.

Direction is always split: a mean over both directions hides friction. Empty bins stay empty (NaN), they are never
filled from their neighbours; bins with few independent samples are marked. Every bin says which share of the error it
holds, so that the reader sees what matters and not only what is large. `sentence` says in plain words where the error
of a channel sits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.drive.effect import LINK
from hd_control.lab.balances.channels import JointEquations

DIRECTIONS = (-1, 0, 1)
"""Rows of every map: backward, at rest, forward."""
ANGLE_BINS = 72
SPEED_BINS = 12
LOAD_BINS = 10
EVEN_BINS = 30
LEAST_EFFECTIVE = 30.0
"""Independent samples below which a bin is marked."""
UNITS = {
    "motor_velocity": "rad/s",
    "joint_velocity": "rad/s",
    "joint_torque": "N m",
    "motor_shaft_position": "rad",
    "joint_position": "rad",
    "direction": "",
    "reversal_travel": "rad",
    "reversal_time": "s",
    "temperature": "deg C",
    "time": "s",
}
"""Variables of maps and their units, in the order of the pictures."""
SPEEDS = ("motor_velocity", "joint_velocity")


@dataclass(frozen=True)
class Conditions:
    """Operating conditions at the rows of a channel: variable of `UNITS` -> (rows,), speeds without sign.

    `direction` (rows,): -1, 0 at rest, 1.
    """

    direction: FloatArray
    variables: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Statistics:
    """Per bin: samples, independent samples, mean and RMS residual (NaN where empty), share of the squared error."""

    count: FloatArray
    effective: FloatArray
    mean: FloatArray
    rms: FloatArray
    share: FloatArray

    @property
    def few(self) -> BoolArray:
        """Bins that hold something, but too few independent samples to be trusted."""
        return np.asarray((self.count > 0) & (self.effective < LEAST_EFFECTIVE))


@dataclass(frozen=True)
class ConditionMap:
    """Residual over one variable: `edges` (bins + 1,); statistics (3, bins), rows as `DIRECTIONS`.

    `explained`: share of the squared error that the bins' means account for, corrected for the number of bins.
    """

    variable: str
    edges: FloatArray
    bins: Statistics
    explained: float

    @property
    def unit(self) -> str:
        """Unit of the variable."""
        return UNITS[self.variable]


@dataclass(frozen=True)
class SpeedLoadMap:
    """Residual over speed and load: statistics (3, speed bins, load bins), rows as `DIRECTIONS`."""

    speed: str
    speed_edges: FloatArray
    load_edges: FloatArray
    bins: Statistics


@dataclass(frozen=True)
class ChannelMaps:
    """All maps of one channel; `rms` of the residual over all rows, unit of the channel."""

    rms: float
    maps: Mapping[str, ConditionMap]
    speed_load: SpeedLoadMap | None


def conditions_of(equations: JointEquations, channel: str) -> Conditions:
    """The conditions at the rows of one channel of a joint. What is not measured is left out."""
    step = equations.channels[channel].band.step
    s, d = equations.states, equations.derived
    speed = "joint_velocity" if channel == LINK else "motor_velocity"
    found = {
        speed: np.abs(getattr(s, speed)),
        "joint_torque": s.joint_torque,
        "motor_shaft_position": np.mod(s.motor_shaft_position, 2.0 * np.pi),
        "joint_position": s.joint_position,
        "direction": d.direction,
        "reversal_travel": d.reversal_travel,
        "reversal_time": d.reversal_time,
        "temperature": s.temperature,
        "time": s.time,
    }
    if s.gear_ratio == 1.0:  # the ratio is not known, so neither is the angle of the motor
        del found["motor_shaft_position"]
    rows = {name: np.asarray(x[::step], dtype=float) for name, x in found.items() if np.isfinite(x).all()}
    return Conditions(rows["direction"], rows)


def maps_of(conditions: Conditions, residual: FloatArray, used: BoolArray) -> ChannelMaps:
    """All maps of a residual (rows,) on the rows that are `used` (rows,)."""
    rms = float(np.sqrt(np.mean(residual[used] ** 2))) if used.any() else float("nan")
    maps: dict[str, ConditionMap] = {}
    if used.any():
        for name, values in conditions.variables.items():
            edges = bin_edges(name, values[used])
            if edges.size > 1:
                maps[name] = _one(name, edges, values, conditions.direction, residual, used)
    return ChannelMaps(rms, maps, _speed_load(conditions, residual, used) if used.any() else None)


def bin_edges(variable: str, values: FloatArray) -> FloatArray:
    """Edges (bins + 1,) for the values (n,) of a variable; fewer than two if the variable does not vary."""
    low, high = float(values.min()), float(values.max())
    if variable == "direction":
        return np.array([-1.5, -0.5, 0.5, 1.5])
    if variable == "motor_shaft_position":
        return np.linspace(0.0, 2.0 * np.pi, ANGLE_BINS + 1)
    if not high > low:
        return np.zeros(0)
    if variable in SPEEDS or variable.startswith("reversal"):
        least = max(float(np.quantile(values[values > 0.0], 0.02)), 1e-3 * high)
        edges = np.geomspace(least, high, SPEED_BINS + 1)
        return np.concatenate([[0.0], edges]) if low < edges[0] else edges
    if variable == "joint_torque":
        return np.asarray(np.unique(np.quantile(values, np.linspace(0.0, 1.0, LOAD_BINS + 1))))
    return np.linspace(low, high, EVEN_BINS + 1)


def _one(
    name: str, edges: FloatArray, values: FloatArray, direction: FloatArray, residual: FloatArray, used: BoolArray
) -> ConditionMap:
    bins = edges.size - 1
    index = (direction.astype(np.int64) + 1) * bins + _bin(values, edges)
    statistics, explained = _statistics(index, 3 * bins, residual, used)
    return ConditionMap(name, edges, _shaped(statistics, (3, bins)), explained)


def _speed_load(conditions: Conditions, residual: FloatArray, used: BoolArray) -> SpeedLoadMap | None:
    speed = next((name for name in SPEEDS if name in conditions.variables), None)
    if speed is None or "joint_torque" not in conditions.variables:
        return None
    speeds, loads = conditions.variables[speed], conditions.variables["joint_torque"]
    speed_edges, load_edges = bin_edges(speed, speeds[used]), bin_edges("joint_torque", loads[used])
    if speed_edges.size < 2 or load_edges.size < 2:
        return None
    shape = (3, speed_edges.size - 1, load_edges.size - 1)
    index = (conditions.direction.astype(np.int64) + 1) * shape[1] + _bin(speeds, speed_edges)
    index = index * shape[2] + _bin(loads, load_edges)
    statistics, _ = _statistics(index, int(np.prod(shape)), residual, used)
    return SpeedLoadMap(speed, speed_edges, load_edges, _shaped(statistics, shape))


def _bin(values: FloatArray, edges: FloatArray) -> IntArray:
    """Bin of each value; what lies outside (rows that are not used) goes to the outer bins."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2).astype(np.int64)


def _statistics(index: IntArray, size: int, residual: FloatArray, used: BoolArray) -> tuple[Statistics, float]:
    where, r = index[used], residual[used]
    count = np.bincount(where, minlength=size).astype(float)
    square = np.bincount(where, r**2, minlength=size)
    total = max(float(square.sum()), 1e-300)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(where, r, minlength=size) / count
        rms = np.sqrt(square / count)
    held = count > 0
    around = np.zeros_like(residual)
    around[used] = r - mean[where]
    memory = correlation_time(around, used)
    by_means = float(np.sum(count[held] * mean[held] ** 2))
    left = max(0.0, total - by_means)
    rows = r.size / memory
    chance = left * held.sum() / max(1.0, rows - held.sum())
    explained = max(0.0, by_means - chance) / total
    return Statistics(count, count / memory, mean, rms, square / total), float(explained)


def _shaped(statistics: Statistics, shape: tuple[int, ...]) -> Statistics:
    s = statistics
    return Statistics(*(x.reshape(shape) for x in (s.count, s.effective, s.mean, s.rms, s.share)))


def correlation_time(residual: FloatArray, used: BoolArray) -> float:
    """Rows per independent sample: 1 + 2 x sum of the autocorrelation up to its first zero. At least 1.

    residual (rows,) without mean, zero where it is not `used`; pairs across such rows do not count.
    """
    n = residual.size
    length = 1 << int(2 * n - 1).bit_length()
    mask = used.astype(float)
    pairs = np.fft.irfft(np.abs(np.fft.rfft(mask, length)) ** 2, length)[:n]
    power = np.fft.irfft(np.abs(np.fft.rfft(residual * mask, length)) ** 2, length)[:n]
    if power[0] <= 0.0:
        return 1.0
    lags = np.flatnonzero(pairs > 0.05 * pairs[0])
    correlation = (power[lags] / pairs[lags]) / (power[0] / pairs[0])
    ends = np.flatnonzero(correlation <= 0.0)
    stop = int(ends[0]) if ends.size else correlation.size
    return float(max(1.0, 1.0 + 2.0 * correlation[1:stop].sum()))


def worst(maps: ChannelMaps, limit: int = 8) -> list[dict[str, Any]]:
    """The bins that hold the largest shares of the error, most first, in the form of `hd.compare/1`.

    Speeds carry the sign of the direction; for the other variables the directions are added. Bins that hold no more
    of the error than of the time say nothing and are left out.
    """
    found: list[dict[str, Any]] = []
    for name, item in maps.maps.items():
        rows: Sequence[tuple[int, slice]] = ((1, slice(0, 3)),)
        if name in SPEEDS:
            rows = ((-1, slice(0, 1)), (1, slice(1, 3)))
        total = item.bins.count.sum()
        for sign, part in rows:
            count, share = item.bins.count[part].sum(axis=0), item.bins.share[part].sum(axis=0)
            enough = item.bins.effective[part].sum(axis=0) >= LEAST_EFFECTIVE
            for i in np.flatnonzero(enough & (share > 1.25 * count / total)):
                low, high = sorted((sign * float(item.edges[i]), sign * float(item.edges[i + 1])))
                rms = maps.rms * float(np.sqrt(share[i] * total / count[i]))
                found.append(
                    {"variable": name, "low": low, "high": high, "share_of_error": float(share[i]), "rms_error": rms}
                )
    return sorted(found, key=lambda item: -item["share_of_error"])[:limit]


# ---- The sentence ----------------------------------------------------------------------------------


NAMES = {
    "motor_velocity": "motor speed",
    "joint_velocity": "joint speed",
    "joint_torque": "joint torque",
    "motor_shaft_position": "motor angle",
    "joint_position": "joint angle",
    "direction": "direction",
    "reversal_travel": "travel since the last reversal",
    "reversal_time": "time since the last reversal",
    "temperature": "temperature",
    "time": "time",
}
FOLLOWS = 0.25
"""Share of the error that the means over a variable must explain to be called a dependence."""
CONCENTRATED = 0.12
"""Nats per sample by which the error's place must differ from the time's to be called concentrated."""
SIMPLER = 0.03
"""A variable with fewer bins is named if it explains nearly as much."""
INDIRECT = 0.6
"""Weight of ranges of time and temperature, and of times after a reversal that do not begin at it: with a motion that
changes over time they follow from speed and load."""
AT_FLOOR = 1.1
"""Error over noise floor up to which there is nothing to explain."""


@dataclass(frozen=True)
class Range:
    """Neighbouring bins of a variable: limits, share of the error and of the time, nats per sample by which the two
    differ."""

    variable: str
    low: float
    high: float
    share: float
    time_share: float
    nats: float
    from_start: bool
    to_end: bool


def sentence(maps: ChannelMaps, noise_floor: float = 0.0) -> str:
    """Where the error sits, in one sentence. `noise_floor` in the unit of the channel, 0 if not known."""
    if not maps.maps:
        return "There are no rows to judge."
    if maps.rms <= AT_FLOOR * noise_floor:
        return "The error is at the noise floor: nothing is left to explain here."
    follows, where = dependence(maps), concentration(maps)
    parts = []
    if where is not None and where.nats >= CONCENTRATED:
        share, time_share = 100.0 * where.share, 100.0 * where.time_share
        parts.append(f"{share:.0f} % of the error is {place(where)}, in {time_share:.0f} % of the time")
    if follows is not None:
        also = ", split by direction," if follows.variable != "direction" and _split_matters(follows) else ""
        parts.append(
            f"the mean over {NAMES[follows.variable]}{also} explains {100.0 * follows.explained:.0f} % of the error"
        )
    text = "; ".join(parts) or "the error is spread evenly over speed, load, angle and time"
    return text[0].upper() + text[1:] + "."


def dependence(maps: ChannelMaps) -> ConditionMap | None:
    """The map whose means explain most of the error; None if none explains enough. Nearly equal: the coarsest."""
    best = max((item.explained for item in maps.maps.values()), default=0.0)
    if best < FOLLOWS:
        return None
    near = [item for item in maps.maps.values() if item.explained >= best - SIMPLER]
    return min(near, key=lambda item: item.edges.size)


def concentration(maps: ChannelMaps) -> Range | None:
    """The neighbouring bins of any one variable in which the error is most concentrated."""
    found = [_densest(item) for item in maps.maps.values() if item.variable != "direction"]
    return max((item for item in found if item is not None), key=_weight, default=None)


def _weight(item: Range) -> float:
    indirect = item.variable in ("time", "temperature")
    indirect = indirect or (item.variable.startswith("reversal") and not item.from_start)
    return INDIRECT * item.nats if indirect else item.nats


def _densest(item: ConditionMap) -> Range | None:
    share = item.bins.share.sum(axis=0)
    count = item.bins.count.sum(axis=0)
    bins = share.size
    error = np.concatenate([[0.0], np.cumsum(share / max(share.sum(), 1e-300))])
    time = np.concatenate([[0.0], np.cumsum(count / count.sum())])
    low, high = np.triu_indices(bins + 1, 1)
    s, p = error[high] - error[low], time[high] - time[low]
    s, p = np.clip(s, 1e-12, 1.0 - 1e-12), np.clip(p, 1e-12, 1.0 - 1e-12)
    nats = s * np.log(s / p) + (1.0 - s) * np.log((1.0 - s) / (1.0 - p))
    nats[s <= p] = 0.0
    best = int(np.argmax(nats))
    i, j = int(low[best]), int(high[best])
    if nats[best] <= 0.0:
        return None
    return Range(
        item.variable,
        float(item.edges[i]),
        float(item.edges[j]),
        float(s[best]),
        float(p[best]),
        float(nats[best]),
        i == 0,
        j == bins,
    )


def _split_matters(item: ConditionMap) -> bool:
    """True if the means of the two directions differ by more than they share."""
    count, mean = item.bins.count[[0, 2]], np.nan_to_num(item.bins.mean[[0, 2]])
    both = np.all(count > 0, axis=0)
    odd, even = mean[1, both] - mean[0, both], mean[1, both] + mean[0, both]
    weight = count[:, both].min(axis=0)
    return bool(np.sum(weight * odd**2) > np.sum(weight * even**2))


def place(where: Range) -> str:
    """A range in words: `within 10 ms after a reversal`, `at motor speeds below 0.1 rad/s`."""
    low, high, name = where.low, where.high, where.variable
    if name == "reversal_time":
        return _after(low, high, where, 1e3, "ms") if high < 1.0 else _after(low, high, where, 1.0, "s")
    if name == "reversal_travel":
        return _after(low, high, where, 1e3, "mrad")
    if name in ("joint_position", "motor_shaft_position"):
        return f"at {NAMES[name]}s from {np.degrees(low):.0f} to {np.degrees(high):.0f} degrees"
    if name == "time":
        return f"between {low:.1f} and {high:.1f} s"
    unit = "degrees Celsius" if name == "temperature" else "rad/s" if name in SPEEDS else "N m"
    if where.from_start and where.to_end or not (where.from_start or where.to_end):
        return f"at {NAMES[name]}s from {low:.3g} to {high:.3g} {unit}"
    return f"at {NAMES[name]}s " + (f"below {high:.3g} {unit}" if where.from_start else f"above {low:.3g} {unit}")


def _after(low: float, high: float, where: Range, factor: float, unit: str) -> str:
    if where.from_start:
        return f"within {factor * high:.3g} {unit} after a reversal"
    if where.to_end:
        return f"more than {factor * low:.3g} {unit} after a reversal"
    return f"from {factor * low:.3g} to {factor * high:.3g} {unit} after a reversal"
