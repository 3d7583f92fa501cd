"""A selection of groups fitted to one joint: coefficients, errors in the channel's own unit, values with intervals.

Physical values: what multiplies a motor column is theta = coefficient / a, a link column coefficient / b; the
dictionary is kept in units in which a and b are 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import COULOMB, LINK, MOTOR, TRANSMISSION, VISCOUS, Context, Effect
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.dictionary import Dictionary, base_of
from hd_control.lab.diagnosis.scores import Scores


@dataclass(frozen=True)
class Fit:
    """A fitted selection. `coefficients` (p,) in physical units, zero where not selected."""

    dictionary: Dictionary
    scores: Scores
    selection: tuple[Group, ...]
    coefficients: FloatArray

    @classmethod
    def of(cls, dictionary: Dictionary, scores: Scores, selection: Sequence[Group]) -> Fit:
        """Least squares on all folds."""
        index = index_of(dictionary, selection)
        coefficients = np.zeros(dictionary.size)
        coefficients[index] = scores.fit(index) / dictionary.norm[index]
        return cls(dictionary, scores, tuple(selection), coefficients)

    @property
    def index(self) -> IntArray:
        """Coefficients of base and selection."""
        return index_of(self.dictionary, self.selection)

    def scale(self, channel: str) -> float:
        """a or b of a channel; 1 where the torque stands on the left."""
        i = self.dictionary.base_index(channel, "drive_torque")
        return 1.0 if i is None else float(self.coefficients[i])

    @property
    def scales(self) -> dict[str, float]:
        """a and b by channel, for `Dictionary.rescaled`."""
        return {name: self.scale(name) for name in (MOTOR, LINK) if name in self.dictionary.rows}

    def base(self, channel: str, name: str) -> float | None:
        """Physical coefficient of a base column."""
        i = self.dictionary.base_index(channel, name)
        if i is None:
            return None
        return self.dictionary.equations.offset(channel, name) + float(self.coefficients[i]) / self.scale(channel)

    @property
    def rotor_inertia(self) -> float:
        """I*, kg m^2, from the scale or the correction."""
        correction = self.base(MOTOR, "inertia_correction") or 0.0
        return self.dictionary.equations.inertia / self.scale(MOTOR) * (1.0 + correction)

    @property
    def link_inertia_scale(self) -> float:
        """True over nominal link inertia: 1 / b, or 1 + correction."""
        correction = self.base(LINK, "inertia_correction") or 0.0
        return self.dictionary.equations.link_scale / self.scale(LINK) * (1.0 + correction)

    @property
    def torsional_stiffness(self) -> float:
        """k, N m/rad; NaN without a transmission channel."""
        compliance = self.base(TRANSMISSION, "torsional_compliance")
        return 1.0 / compliance if compliance and compliance > 0.0 else float("nan")

    @property
    def coulomb_torque(self) -> float:
        """N m; NaN without a rotor balance."""
        return _or_nan(self.base(MOTOR, COULOMB))

    @property
    def viscous(self) -> float:
        """N m s; NaN without a rotor balance."""
        return _or_nan(self.base(MOTOR, VISCOUS))

    @property
    def transmission_zero(self) -> float:
        """rad; NaN without a transmission channel."""
        return _or_nan(self.base(TRANSMISSION, "transmission_zero"))

    def relative_error(self, channel: str, name: str) -> float:
        """Half-width of the 95 % interval of a base coefficient over its value, for white noise."""
        i = self.dictionary.base_index(channel, name)
        index = self.index
        left = self.scores.gram_all[np.ix_(index, index)] + np.diag(self.scores.ridge[index])
        value = self.base(channel, name)
        if i is None or not value:
            return float("inf")
        unit = (index == i).astype(float)
        deviation = float(np.sqrt(unit @ np.linalg.solve(left, unit))) / self.dictionary.norm[i]
        return float(1.96 * deviation / abs(value * self.scale(channel)))

    @property
    def damping_time(self) -> float:
        """d, s; NaN without a transmission channel."""
        change = self.base(TRANSMISSION, "torsional_damping")
        if change is None:
            return float("nan")
        return self.dictionary.equations.damping_time + change * self.torsional_stiffness

    def context(self, default: Context) -> Context:
        """Stiffness and Coulomb torque for the change to physical parameters; `default` where a channel is missing."""
        compliance = self.base(TRANSMISSION, "torsional_compliance")
        stiffness = 1.0 / compliance if compliance and compliance > 0.0 else default.torsional_stiffness
        coulomb = self.base(MOTOR, COULOMB)
        return Context(
            stiffness, default.coulomb_torque if coulomb is None else coulomb, self.states_scale, default.extra
        )

    @property
    def states_scale(self) -> float:
        """The torque scale of the recording, N m."""
        return self.dictionary.equations.states.torque_scale

    def parameters(self, group: Group, default: Context) -> dict[str, float]:
        """Physical parameters of a selected effect."""
        assert group.effect is not None
        values = self.coefficients[group.index] / self._group_scale(group)
        return group.effect.join(group.shape, values, self.context(default))

    def _group_scale(self, group: Group) -> float:
        return float(np.mean([self.scale(name) for name in group.channels]))

    def residuals(self) -> dict[str, FloatArray]:
        """Whitened residual (rows,) by channel."""
        scaled = self.coefficients * self.dictionary.norm
        return {name: part.left - part.columns @ scaled[part.index] for name, part in self.dictionary.rows.items()}


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def index_of(dictionary: Dictionary, selection: Sequence[Group]) -> IntArray:
    """Coefficients of the base and a selection."""
    return np.concatenate([dictionary.base, *(group.index for group in selection)])


class RawRows:
    """Unwhitened rows of base and selected groups, for errors in the channel's unit. Built once for several groups."""

    def __init__(self, dictionary: Dictionary, groups: Sequence[Group]) -> None:
        self.dictionary, self.groups = dictionary, tuple(groups)
        states = dictionary.equations.states
        self._parts: dict[str, tuple[FloatArray, IntArray]] = {}
        raw = {id(g): _columns(g, states) for g in (*dictionary.known, *groups)}
        for name, channel in dictionary.equations.channels.items():
            columns, index = [channel.base_matrix], [base_of(channel, dictionary.base_names)]
            for group in (*dictionary.known, *groups):
                if name in group.channels:
                    columns.append(channel.rows_of(raw[id(group)][name]))
                    index.append(group.index)
            self._parts[name] = np.concatenate(columns, axis=1), np.concatenate(index)

    def residual(self, coefficients: FloatArray) -> dict[str, FloatArray]:
        """Left side minus columns times physical coefficients (p,), all rows of each channel."""
        found = {}
        for name, (columns, index) in self._parts.items():
            channel = self.dictionary.equations.channels[name]
            found[name] = channel.left - columns @ coefficients[index]
        return found

    def held_out_errors(self, scores: Scores, selection: Sequence[Group]) -> dict[str, float]:
        """RMS by channel on rows that were not used for the fit, fold by fold."""
        index = index_of(self.dictionary, selection)
        folds = scores.train(index) / self.dictionary.norm[index]
        squares = dict.fromkeys(self._parts, 0.0)
        counts = dict.fromkeys(self._parts, 0)
        for fold, values in enumerate(folds):
            coefficients = np.zeros(self.dictionary.size)
            coefficients[index] = values
            for name, residual in self.residual(coefficients).items():
                part = self.dictionary.rows[name]
                rows = residual[part.usable][part.fold == fold]
                squares[name] += float(rows @ rows)
                counts[name] += rows.size
        return {name: float(np.sqrt(squares[name] / max(1, counts[name]))) for name in squares}


def _columns(group: Group, states: object) -> Mapping[str, FloatArray]:
    from hd_control.drive.effect import DriveStates

    assert isinstance(states, DriveStates)
    if group.curve is not None:
        return group.curve.columns_at(states)
    assert group.effect is not None
    return group.effect.columns(states, group.shape)


# ---- Intervals by a block bootstrap, shapes included to first order --------------------------------
#
# Least-squares standard errors are too small: residuals are correlated, the model is slightly wrong. Blocks of time are
# drawn with replacement; every draw solves base, coefficients and, linearised, the shapes again.


BLOCK_S = 1.32
DRAWS = 200


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
    """Draws of all coefficients of a fit: `coefficients` (draws, p) physical, `shapes` by (group name, entry).

        c_d = (sum_b w_db G_b + R + P)^-1 sum_b w_db r_b        G_b, r_b of block b; w_d: how often draw d holds it

    over the columns of the fit and, for each shape entry p of an effect with coefficients t, the column (dX/dp) t.
    """

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
        assert group.effect is not None
        best = self.fit.parameters(group, default)
        found = {name: interval_of(best[name], draws) for name, draws in self.draws_of(group, default).items()}
        return widened(group.effect, found)

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
            slope = {name: ((moved[name] - held[name]) @ coefficients / h)[:, None] for name in group.channels}
            columns = {name: c[:, 0] for name, c in fit.dictionary.whitened(slope, group.effect.reads).items()}
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


def widened(effect: type[Effect], found: Mapping[str, Interval]) -> dict[str, Interval]:
    """The intervals of one effect with what its law may be wrong by: `Effect.law_error` of each value in quadrature, of
    the amplitude for the cosine and sine of one wave, of 1 rad for a phase."""
    return {name: _wider(interval, effect.law_error * _size(name, found)) for name, interval in found.items()}


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
