"""The friction curve of a joint: torque over speed, by direction, load and temperature, known torques removed.

    mean over a window of T(t) = sum_b c_b mean(1[speed and direction in bin b]) + n . mean(nuisances) + rest

T is a measured torque less what is known: gauge torque from motor torque, or the links' rigid-body torque. Nuisances
are the acceleration (inertia), scales of what was subtracted, and sine and cosine of the joint angle (gravity that no
model knows). Both sides are means over the same windows, so that no filter smears the step at a reversal; windows in
which the joint rests, preslides or turns are left out. c_b is the curve; forward and backward stay apart. Its 95 %
intervals come from a bootstrap over blocks of time, nuisances fitted again in each draw, and are wider by what is not
known of the torque's delay.

Nothing here rests on a model of friction, and nothing on a guessed inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.drive.effect import DriveStates
from hd_control.lab.balances.channels import JointEquations

WINDOW_S, FEWEST_SAMPLES = 0.05, 5
"""Length of a window, and samples in it at least."""
PER_DECADE, MOST_BINS = 8, 14
GROUP_PER_DECADE, MOST_GROUP_BINS = 4, 6
"""Speed bins per decade and in all; fewer where loads or temperatures are split."""
LEAST_S = 0.25
"""s that a bin must hold to be shown."""
BLOCK_S, FEWEST_BLOCKS, DRAWS = 2.0, 6, 120
SCALE_PRIOR = 0.2
"""Standard deviation of the scale of a torque that was subtracted: a gauge's gain, the mass of a description."""
GROUPS = 3
SAME_SPEED = 1.1
"""Speeds of both directions whose ratio is below this count as the same."""
LOAD_SPREAD, WARM = 0.5, 3.0
"""Range of the load over the middle size of the torque, and K, from which on the curve is split."""
HALF_SAMPLE = 0.5
"""Samples by which a torque may be late or early without anybody having said so: held, or measured at its stamp."""
FEWEST_OF_A_BIN = 3
"""Blocks of time without which a bin has no interval."""


@dataclass(frozen=True)
class FrictionPoint:
    """Friction in one bin of speed: mean `speed` rad/s of the output, `torque` N m against the motion with its 95 %
    interval; `direction` 1, -1, or 0 for the mean of both (half the difference of the torque); `seconds` of data."""

    direction: int
    speed: float
    torque: float
    low: float
    high: float
    seconds: float

    def json(self) -> dict[str, float | None]:
        """The form of `friction` in `hd.compare/1`."""
        known = bool(np.isfinite(self.low))
        return {
            "direction": self.direction, "speed": self.speed, "torque": self.torque,
            "low": self.low if known else None, "high": self.high if known else None, "seconds": self.seconds,
        }  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """A range of load (N m, absolute) or temperature (deg C) for which a curve holds."""

    variable: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class FrictionCurve:
    """Friction that one torque sensor sees. `removed`: what was subtracted or fitted beside it, in words; `groups`: the
    same by load and by temperature; `per_ms`: largest change of the mean of both directions, N m, if the torque came
    one ms later."""

    signal: str
    points: tuple[FrictionPoint, ...]
    removed: tuple[str, ...]
    per_ms: float
    groups: Mapping[Condition, tuple[FrictionPoint, ...]] = field(default_factory=dict)

    def of(self, direction: int) -> tuple[FrictionPoint, ...]:
        """The points of one direction, slowest first."""
        return tuple(point for point in self.points if point.direction == direction)

    def json(self) -> dict[str, Any]:
        """The form of `friction` in `hd.compare/1`."""
        return {
            "unit": "N m",
            "removed": list(self.removed),
            "change_per_ms_of_delay": self.per_ms,
            "points": [point.json() for point in self.points],
            "groups": [
                {**vars(group), "points": [point.json() for point in points]} for group, points in self.groups.items()
            ],
        }


Delays = Mapping[str, tuple[float, float]]
"""Signal -> how late it is, s, and what is not known of that."""


def friction_curves(equations: JointEquations, delays: Delays | None = None) -> tuple[FrictionCurve, ...]:
    """What motor torque and gauge torque show of friction; empty where nothing slides. A signal with a measured delay
    is taken earlier by it."""
    seen = [_motor_view(equations, delays or {}), _gauge_view(equations, delays or {})]
    found = [_curve(view, equations) for view in seen if view is not None]
    return tuple(curve for curve in found if curve is not None)


# ---- What is measured, and what is known of it -----------------------------------------------------


FITTED_INERTIA = "inertia fitted"
FITTED_GRAVITY = (
    "gravity fitted as sine and cosine of the angle, other joints taken as standing; "
    "an offset of both directions is not separable from it and left out"
)
KNOWN_LINKS = "the model's rigid-body torque subtracted, its scale and a sine and cosine of the angle fitted"


@dataclass(frozen=True)
class _View:
    """One torque (n,) less what is known; nuisances (n,) by name with the standard deviation of their coefficient."""

    signal: str
    torque: FloatArray
    nuisances: Mapping[str, tuple[FloatArray, float]]
    load: FloatArray | None
    removed: tuple[str, ...]
    period: float
    late: float
    offset_unknown: bool = False


_Mean = Callable[[FloatArray], FloatArray]


def _motor_view(equations: JointEquations, delays: Delays) -> _View | None:
    """Motor torque less gauge torque; without a gauge less the links' torque."""
    s = equations.states
    if not np.isfinite(s.motor_torque).all():
        return None
    torque, words, late = _earlier(s, s.motor_torque, "motor_torque", delays)
    nuisances = {"inertia": (s.motor_acceleration, np.inf)}
    if "gauge_torque" not in equations.substituted and np.isfinite(s.gauge_torque).all():
        gauge, more, also = _earlier(s, s.gauge_torque, "gauge_torque", delays)
        nuisances["gauge"] = (s.joint_torque, SCALE_PRIOR)
        words = (*words, *more, "gauge torque subtracted", FITTED_INERTIA)
        return _View("motor_torque", torque - gauge, nuisances, s.joint_torque, words, s.period, max(late, also))
    return _beside_links(equations, _View("motor_torque", torque, nuisances, None, words, s.period, late))


def _gauge_view(equations: JointEquations, delays: Delays) -> _View | None:
    """Gauge torque less the links' torque: friction behind the sensor, and what the sensor sees of the gear."""
    s = equations.states
    if "gauge_torque" in equations.substituted or not np.isfinite(s.gauge_torque).all():
        return None
    torque, words, late = _earlier(s, s.gauge_torque, "gauge_torque", delays)
    nuisances = {"inertia": (s.motor_acceleration, np.inf)}
    return _beside_links(equations, _View("gauge_torque", torque, nuisances, None, words, s.period, late))


def _beside_links(equations: JointEquations, view: _View) -> _View:
    """The torque less what the model knows of the links, beside nuisances for what it does not."""
    s = equations.states
    nuisances = {
        **view.nuisances,
        "sine": (np.sin(s.joint_position), np.inf),
        "cosine": (np.cos(s.joint_position), np.inf),
    }
    known = np.isfinite(s.link_bias_torque).all()
    torque = view.torque - (s.link_inertia_torque + s.link_bias_torque) if known else view.torque
    if not known or float(np.ptp(s.link_bias_torque)) == 0.0:
        words = (*view.removed, FITTED_INERTIA, FITTED_GRAVITY)
        return replace(view, torque=torque, nuisances=nuisances, removed=words, offset_unknown=True)
    nuisances |= {"gravity": (s.link_bias_torque, SCALE_PRIOR), "links": (s.link_inertia_torque, SCALE_PRIOR)}
    words = (*view.removed, FITTED_INERTIA, KNOWN_LINKS)
    return replace(view, torque=torque, nuisances=nuisances, removed=words, load=s.link_bias_torque)


def _earlier(
    states: DriveStates, values: FloatArray, name: str, delays: Delays
) -> tuple[FloatArray, tuple[str, ...], float]:
    """A signal (n,) without its delay, that in words, and what is not known of it, s."""
    late, error = delays.get(name, (0.0, HALF_SAMPLE * states.period))
    if late == 0.0:
        return values, (), error
    words = f"{name} taken {1e3 * abs(late):.3g} ms {'earlier' if late > 0.0 else 'later'}, as measured"
    return np.interp(states.time + late, states.time, values), (words,), error


# ---- The fit ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Rows:
    """Means over windows of `seconds`: torque, its slope, direction (rows,); nuisances (rows, k) with priors (k,);
    `speed` (rows, samples) in each window; `block` (rows,) of time. `late` s: what is not known of its delay."""

    torque: FloatArray
    slope: FloatArray
    speed: FloatArray
    direction: FloatArray
    nuisances: FloatArray
    prior: FloatArray
    block: IntArray
    seconds: float
    late: float


def _curve(view: _View, equations: JointEquations) -> FrictionCurve | None:
    d, s = equations.derived, equations.states
    width = max(FEWEST_SAMPLES, round(WINDOW_S / s.period))
    windows = d.usable.size // width
    use = (d.usable & d.sliding & (d.direction != 0.0))[: windows * width].reshape(windows, width).all(axis=1)
    if use.sum() < 2 * FEWEST_BLOCKS:
        return None

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(values[: windows * width].reshape(windows, width).mean(axis=1)[use])

    speed = d.motor_velocity[: windows * width].reshape(windows, width)[use]
    rows = _rows(view, speed, mean, width * s.period, np.flatnonzero(use))
    edges = speed_edges(rows.speed, PER_DECADE, MOST_BINS)
    points, per_ms = _points(rows, edges, np.zeros(rows.torque.size, np.int64))
    if view.offset_unknown and len({p.direction for _, p in points}) < 3:
        return None  # one way only, friction is not separable from a constant
    offset = _offset(points) if view.offset_unknown else 0.0
    groups: dict[Condition, tuple[FrictionPoint, ...]] = {}
    coarse = speed_edges(rows.speed, GROUP_PER_DECADE, MOST_GROUP_BINS)
    for variable, unit, values in _variables(view, s.temperature):
        least = WARM if variable == "temperature" else LOAD_SPREAD * float(np.median(np.abs(rows.torque)))
        if found := _split(variable, unit, mean(values), least):
            which = np.searchsorted([group.low for group in found[1:]], mean(values), side="right")
            split, _ = _points(rows, coarse, which)
            groups |= {group: _moved(split, i, offset) for i, group in enumerate(found)}
    return FrictionCurve(view.signal, _moved(points, 0, offset), view.removed, per_ms, groups)


def _rows(view: _View, velocity: FloatArray, mean: _Mean, seconds: float, index: IntArray) -> _Rows:
    """`velocity` (rows, samples) and the indices (rows,) of the windows that are used."""
    columns = [mean(column) for column, _ in view.nuisances.values()]
    table = np.column_stack([column - column.mean() for column in columns])
    prior = np.array([deviation for _, deviation in view.nuisances.values()])
    slope, way = mean(np.gradient(view.torque)) / view.period, np.sign(velocity.mean(axis=1))
    block = (index * seconds / BLOCK_S).astype(np.int64)
    return _Rows(mean(view.torque), slope, np.abs(velocity), way, table, prior, block, seconds, view.late)


def speed_edges(speed: FloatArray, per_decade: int, most: int) -> FloatArray:
    """Logarithmic edges (bins + 1,) over the speeds (n,) that occur, the outermost 1 % left out."""
    low, high = (float(x) for x in np.quantile(speed, [0.01, 0.995]))
    low = max(low, 1e-3 * high)
    bins = int(np.clip(round(per_decade * np.log10(max(high / low, 1.0))), 1, most))
    return np.geomspace(0.999 * low, 1.001 * max(high, low), bins + 1)


def _variables(view: _View, temperature: FloatArray) -> list[tuple[str, str, FloatArray]]:
    found = [] if view.load is None else [("load", "N m", np.abs(view.load))]
    return [*found, ("temperature", "deg C", temperature)] if np.isfinite(temperature).all() else found


def _split(variable: str, unit: str, values: FloatArray, least: float) -> list[Condition]:
    """Equal parts of the range of a load or temperature (rows,); empty if that is below `least`."""
    low, high = (float(x) for x in np.quantile(values, [0.02, 0.98]))
    if high - low < least:
        return []
    edges = np.linspace(low, high, GROUPS + 1)
    return [Condition(variable, unit, float(a), float(b)) for a, b in pairwise(edges)]


_Found = list[tuple[int, FrictionPoint]]
"""Group and point."""


def _offset(points: _Found) -> float:
    """Torque N m that both directions have in common, seconds as weights."""
    pairs = [(f, b) for _, f in points for _, b in points if (f.direction, b.direction) == (1, -1)]
    near = [(f, b) for f, b in pairs if max(f.speed, b.speed) < SAME_SPEED * min(f.speed, b.speed)]
    weights = np.array([min(f.seconds, b.seconds) for f, b in near])
    return float(weights @ [0.5 * (f.torque - b.torque) for f, b in near] / weights.sum()) if near else 0.0


def _moved(points: _Found, group: int, offset: float) -> tuple[FrictionPoint, ...]:
    """The points of one group without a common offset."""
    return tuple(
        replace(p, torque=p.torque - x, low=p.low - x, high=p.high - x)
        for k, p in points
        for x in (p.direction * offset,)
        if k == group
    )


def _points(rows: _Rows, edges: FloatArray, group: IntArray) -> tuple[_Found, float]:
    """(group, point) of every bin that holds enough, and the change of the curve per ms of delay."""
    bins, samples = edges.size - 1, rows.speed.shape[1]
    place = np.searchsorted(edges, rows.speed, side="right") - 1
    cell = ((2 * group + (rows.direction > 0.0)) * bins)[:, None] + np.clip(place, 0, bins - 1)
    cells, outside = 2 * bins * (int(group.max()) + 1), (place < 0) | (place >= bins)
    count = np.bincount(cell[~outside], minlength=cells) / samples
    inside = ~(outside | (count[cell] * rows.seconds < LEAST_S)).any(axis=1)
    if not inside.any():
        return [], float("nan")
    shown, column = np.unique(cell[inside], return_inverse=True)
    index = (np.repeat(np.arange(int(inside.sum())), samples) * shown.size + column.ravel()).astype(np.int64)
    share = np.bincount(index, minlength=int(inside.sum()) * shown.size).reshape(-1, shown.size) / samples
    fit = _Fit(share, _only(rows, inside))
    speed = np.bincount(column.ravel(), rows.speed[inside].ravel()) / np.bincount(column.ravel())
    at = {int(c): i for i, c in enumerate(shown)}
    found, slopes = list[tuple[int, FrictionPoint]](), [0.0]
    for c, i in at.items():
        sign, seconds = 1 if (c // bins) % 2 else -1, float(count[c] * rows.seconds)
        one = fit.combined({i: float(sign)})
        found.append((c // (2 * bins), FrictionPoint(sign, float(speed[i]), *one[:3], seconds)))
        other = at.get(c + bins)
        if sign < 0 and other is not None:
            both = fit.combined({i: -0.5, other: 0.5})
            middle, seconds = 0.5 * float(speed[i] + speed[other]), seconds + float(count[c + bins] * rows.seconds)
            found.append((c // (2 * bins), FrictionPoint(0, middle, *both[:3], seconds)))
            slopes.append(abs(both[3]))
    return found, 1e-3 * max(slopes)


def _only(rows: _Rows, keep: BoolArray) -> _Rows:
    return replace(
        rows, torque=rows.torque[keep], slope=rows.slope[keep], speed=rows.speed[keep], direction=rows.direction[keep],
        nuisances=rows.nuisances[keep], block=rows.block[keep],
    )  # fmt: skip


class _Fit:
    """Bins and nuisances fitted together, on all rows and on resampled blocks of time."""

    def __init__(self, share: FloatArray, rows: _Rows) -> None:
        """`share` (rows, bins): part of each window that lies in each bin."""
        self.bins, self.late = share.shape[1], rows.late
        columns = np.concatenate([share, rows.nuisances], axis=1)
        self._scale, left = np.sqrt((columns**2).mean(axis=0)) + 1e-300, np.column_stack([rows.torque, -rows.slope])
        columns = columns / self._scale
        _, block = np.unique(rows.block, return_inverse=True)
        self.blocks, order = int(block.max()) + 1, np.argsort(block, kind="stable")
        edges = np.searchsorted(block[order], np.arange(self.blocks + 1))
        parts = [order[a:b] for a, b in pairwise(edges)]
        self._gram = np.stack([columns[part].T @ columns[part] for part in parts])
        self._right = np.stack([columns[part].T @ left[part] for part in parts])
        self._held = np.stack([(share[part] > 0.0).any(axis=0) for part in parts])
        self._ridge = self._ridges(rows, columns, left[:, :1])
        value = self._solve(self._gram.sum(axis=0), self._right.sum(axis=0))
        self._value, self._change, self._draws = value[:, 0], value[:, 1], self._resampled()

    def combined(self, weights: Mapping[int, float]) -> tuple[float, float, float, float]:
        """A weighted sum of bins: value, its 95 % interval, and its change per s of delay. The interval holds what is
        not known of the delay; it is NaN where the bins rest on too few blocks."""
        index, w = list(weights), np.array(list(weights.values()))
        value, change = float(w @ self._value[index]), float(w @ self._change[index])
        if self.blocks < FEWEST_BLOCKS or self._held[:, index].sum(axis=0).min() < FEWEST_OF_A_BIN:
            return value, float("nan"), float("nan"), change
        low, high = np.nanquantile(self._draws[:, index] @ w, [0.025, 0.975])
        wider = self.late * abs(change)
        return value, float(low) - wider, float(high) + wider, change

    def _ridges(self, rows: _Rows, columns: FloatArray, torque: FloatArray) -> FloatArray:
        """Weights of the priors: the variance of what is left over that of the prior of each (scaled) coefficient."""
        weak = np.full(columns.shape[1], 1e-9 * len(columns))
        left = torque - columns @ np.linalg.solve(columns.T @ columns + np.diag(weak), columns.T @ torque)
        prior = rows.prior * self._scale[self.bins :]
        weak[self.bins :] += np.where(np.isfinite(prior), float(np.var(left)) / prior**2, 0.0)
        return weak

    def _resampled(self) -> FloatArray:
        """Draws (draws, bins); NaN where a draw has no block of a bin."""
        times = np.random.default_rng(0).multinomial(self.blocks, np.full(self.blocks, 1.0 / self.blocks), DRAWS)
        grams, rights = (np.tensordot(times.astype(float), x, 1) for x in (self._gram, self._right[:, :, :1]))
        draws = np.stack([self._solve(gram, right)[:, 0] for gram, right in zip(grams, rights, strict=True)])
        return np.where(times @ self._held > 0, draws, np.nan)

    def _solve(self, gram: FloatArray, right: FloatArray) -> FloatArray:
        """Bins' coefficients (bins, k)."""
        return np.asarray((np.linalg.solve(gram + np.diag(self._ridge), right) / self._scale[:, None])[: self.bins])
