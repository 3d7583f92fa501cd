"""Intervals of fitted parameters by a block bootstrap, shapes included to first order.

Least-squares standard errors are too small: residuals are correlated, the model is slightly wrong. Blocks of time are
drawn with replacement; every draw solves base, coefficients and, linearised, the shapes again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.fit import Fit
from hd_control.analysis.groups import Group
from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import Context

BLOCK_S = 1.32
DRAWS = 200
LAW_ERROR = {
    "": 0.003,
    "actuation_delay": 0.1,
    "kinematic_error": 0.007,
    "link_friction": 0.02,
    "presliding": 0.4,
    "structural_resonance": 0.015,
    "torsional_hysteresis": 0.14,
}
"""Half-width, relative to the value, of what a law of the library leaves of the world's: where worlds were random and
known (calibration seeds 100 500 to 100 739), the block bootstrap alone covered too rarely by that much. The bristles of
the worlds are damped, the library's presliding is not; a delay is judged beside an undeclared one of the recording."""


@dataclass(frozen=True)
class Interval:
    """A fitted value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class _Slope:
    """A continuous entry of a group's shape: which one, and its column in the extended system."""

    group: Group
    entry: str
    step: float
    column: int


class Bootstrap:
    """Draws of all coefficients of a fit: `coefficients` (draws, p) physical, `shapes` by (group name, entry)."""

    def __init__(self, fit: Fit, seed: int = 0, draws: int = DRAWS) -> None:
        self.fit = fit
        slopes, extra = _slopes(fit)
        index = fit.index
        size = index.size + len(slopes)
        grams, rights = _blocks(fit, extra, size)
        prior = fit.dictionary.precision[index] / fit.dictionary.norm[index] ** 2
        ridge = np.concatenate([fit.dictionary.ridge[index] + prior, np.full(len(slopes), 1e-6)])
        random = np.random.default_rng(seed)
        count = grams.shape[0]
        weights = random.multinomial(count, np.full(count, 1.0 / count), size=draws).astype(float)
        left = np.tensordot(weights, grams, 1)
        left[:, np.arange(size), np.arange(size)] += ridge
        solved = np.linalg.solve(left, (weights @ rights)[..., None])[..., 0]
        self.coefficients = np.zeros((draws, fit.dictionary.size))
        self.coefficients[:, index] = solved[:, : index.size] / fit.dictionary.norm[index]
        self.shapes = {(s.group.name, s.entry): solved[:, index.size + i] * s.step for i, s in enumerate(slopes)}

    def parameters(self, group: Group, default: Context) -> dict[str, Interval]:
        """Physical parameters of a selected effect with intervals."""
        best = self.fit.parameters(group, default)
        found = {name: interval_of(best[name], draws) for name, draws in self.draws_of(group, default).items()}
        return widened(group.name, found)

    def draws_of(self, group: Group, default: Context) -> dict[str, FloatArray]:
        """Draws (draws,) of the physical parameters of a selected effect."""
        assert group.effect is not None
        best = self.fit.parameters(group, default)
        draws: dict[str, list[float]] = {name: [] for name in best}
        for k, coefficients in enumerate(self.coefficients):
            fit = Fit(self.fit.dictionary, self.fit.scores, self.fit.selection, coefficients)
            shape = dict(group.shape)
            for (name, entry), change in self.shapes.items():
                if name == group.name:
                    shape[entry] = _inside(float(group.shape[entry]), float(change[k]))
            moved = Group(group.name, group.index, group.channels, group.effect, shape)
            for name, value in fit.parameters(moved, default).items():
                draws[name].append(value)
        return {name: np.array(values) for name, values in draws.items()}

    def base(self, name: str) -> FloatArray:
        """Draws (draws,) of a number of the base: an attribute of Fit."""
        fits = (Fit(self.fit.dictionary, self.fit.scores, self.fit.selection, c) for c in self.coefficients)
        return np.array([float(getattr(fit, name)) for fit in fits])


def _inside(value: float, change: float) -> float:
    """A positive shape stays positive: at most a factor of three."""
    return float(np.clip(value + change, value / 3.0, value * 3.0)) if value > 0.0 else value + change


def interval_of(value: float, draws: FloatArray) -> Interval:
    """95 % interval of a value from draws (draws,), centred on the value."""
    low, high = np.quantile(draws[np.isfinite(draws)], [0.025, 0.975]) if np.isfinite(draws).any() else (value, value)
    centre = float(np.median(draws)) if np.isfinite(draws).all() else value
    return Interval(value, float(value + low - centre), float(value + high - centre))


def _slopes(fit: Fit) -> tuple[list[_Slope], dict[str, list[tuple[int, FloatArray]]]]:
    """Derivative columns of the shapes of selected effects, whitened and scaled to unit norm, by channel."""
    states = fit.dictionary.equations.states
    slopes: list[_Slope] = []
    extra: dict[str, list[tuple[int, FloatArray]]] = {name: [] for name in fit.dictionary.rows}
    for group in fit.selection:
        if group.effect is None:
            continue
        coefficients = fit.coefficients[group.index]
        for entry in group.effect.shape_bounds(group.shape, states):
            value = float(group.shape[entry])
            h = 1e-3 * max(abs(value), 1e-6)
            moved = group.effect.columns(states, {**group.shape, entry: value + h})
            held = group.effect.columns(states, dict(group.shape))
            columns = {
                name: fit.dictionary.whitened(name, ((moved[name] - held[name]) @ coefficients / h)[:, None])[:, 0]
                for name in group.channels
            }
            norm = float(np.sqrt(sum((c**2).sum() for c in columns.values())))
            if norm > 0.0:
                for name, column in columns.items():
                    extra[name].append((len(slopes), column / norm))
                slopes.append(_Slope(group, entry, 1.0 / norm, len(slopes)))
    return slopes, extra


def _blocks(fit: Fit, extra: dict[str, list[tuple[int, FloatArray]]], size: int) -> tuple[FloatArray, FloatArray]:
    """Gram matrices (blocks, size, size) and right sides (blocks, size) by block of time, channels added."""
    index = fit.index
    count = 1 + max(int(part.time[-1] / BLOCK_S) for part in fit.dictionary.rows.values() if part.time.size)
    grams, rights = np.zeros((count, size, size)), np.zeros((count, size))
    place = {int(j): i for i, j in enumerate(index)}
    for name, part in fit.dictionary.rows.items():
        mine = np.flatnonzero(np.isin(part.index, index))
        where = [place[int(j)] for j in part.index[mine]] + [index.size + i for i, _ in extra[name]]
        x = np.column_stack([part.columns[:, mine], *(column for _, column in extra[name])])
        target = part.left
        block = np.floor(part.time / BLOCK_S).astype(np.int64)
        edges = np.searchsorted(block, np.arange(count + 1))
        for b in range(count):
            rows = slice(edges[b], edges[b + 1])
            grams[b][np.ix_(where, where)] += x[rows].T @ x[rows]
            rights[b][where] += x[rows].T @ target[rows]
    return grams[np.trace(grams, axis1=1, axis2=2) > 0], rights[np.trace(grams, axis1=1, axis2=2) > 0]


def widened(effect: str, found: Mapping[str, Interval]) -> dict[str, Interval]:
    """The intervals of one effect with what its law may be wrong by: `LAW_ERROR` of each value in quadrature, of the
    amplitude for the cosine and sine of one wave, of 1 rad for a phase."""
    share = LAW_ERROR.get(effect, LAW_ERROR[""])
    return {name: _wider(interval, share * _size(name, found)) for name, interval in found.items()}


def _wider(interval: Interval, error: float) -> Interval:
    below, above = interval.value - interval.low, interval.high - interval.value
    low = interval.value - float(np.copysign(np.hypot(below, error), below))
    return Interval(interval.value, low, interval.value + float(np.copysign(np.hypot(above, error), above)))


def _size(name: str, found: Mapping[str, Interval]) -> float:
    kind, _, order = name.rpartition("_")
    if kind in ("cosine", "sine"):
        waves = [found[f"{wave}_{order}"].value for wave in ("cosine", "sine") if f"{wave}_{order}" in found]
        return float(np.hypot.reduce(waves))
    if name.endswith(("_phase", "_order")):  # an order is a whole number
        return float(name.endswith("_phase"))
    return abs(found[name].value)
