"""Everything that could stand in the balances of one joint, filtered and whitened: base, effects with shapes, curves.

A **group** is what is added or dropped as one: the columns of one effect with one shape, or of one free curve. All
columns have unit norm after whitening; a coefficient that acts on several channels is one coefficient. The noise of a
channel comes from the residual of everything at once. Blocks of time are dealt to folds, so that what is held out is
never next to what is fitted.

    white row    y~_k = (y_k + sum_i lags[i] y_{k-1-i}) / (scale level(v_k))        of a left side or a column alike
    column       x_j = x~_j / norm_j    norm_j^2 = sum x~_j^2 over the rows of all channels
    coefficient  physical = scaled / norm_j, for scaled x_j = physical x~_j
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.drive.effect import Columns
from hd_control.lab.balances.channels import Base, Channel, JointEquations
from hd_control.lab.balances.noise import Noise, fit_noise
from hd_control.lab.diagnosis.candidates import Candidate, Group, group_of

# ---- Blocks and folds ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Blocks:
    """Blocks of `length` s with a guard, dealt to `folds` folds in turn."""

    length: float = 0.66
    guard: float = 0.05
    folds: int = 6

    def of(self, time: FloatArray) -> tuple[IntArray, IntArray]:
        """(block, fold) of each row; fold -1 in the guards."""
        block = np.floor(time / self.length).astype(np.int64)
        inside = time - block * self.length
        guard = (inside < 0.5 * self.guard) | (inside > self.length - 0.5 * self.guard)
        return block, np.where(guard, -1, block % self.folds)


# ---- The noise of a channel ------------------------------------------------------------------------


RIDGE_NOISE = 1e-7
LONELY = 2.0
"""Error in unseen rows over that in seen ones, relative to the usual ratio, from which on a block stands alone."""


def rich_noise(channel: Channel, raw: FloatArray, velocity: FloatArray) -> Noise:
    """Noise from the residual of everything at once: what no column explains.

    A rich fit leaves too little in its own rows and too much in rows that it has not seen, both by the same factor to
    first order and most at low frequencies, where the columns live; the noise is their geometric mean, row by row:

        seen   = y - X (G + r I)^-1 b                      G = sum_f G_f, b = sum_f b_f over all fitted rows
        unseen = y - X (G - G_f + r I)^-1 (b - b_f)        on the rows of fold f
        e      = sign(seen) sqrt(|seen unseen|)            whose autoregression is the noise
    """
    scale = np.sqrt((raw[channel.fitted] ** 2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    x, y, use = raw / scale, channel.left, channel.fitted
    block, fold = Blocks().of(channel.time)
    parts = [use & (fold == f) for f in range(-1, Blocks().folds)]
    grams = [x[part].T @ x[part] for part in parts]
    rights = [x[part].T @ y[part] for part in parts]
    gram, right = sum(grams) + RIDGE_NOISE * np.eye(scale.size), sum(rights)
    seen = y - x @ np.linalg.solve(gram, right)
    unseen = seen.copy()
    for f in range(Blocks().folds):
        rows = fold == f
        unseen[rows] = y[rows] - x[rows] @ np.linalg.solve(gram - grams[f + 1], right - rights[f + 1])
    residual = np.sign(seen) * np.sqrt(np.abs(seen * _without_outliers(seen, unseen, block, use & (fold >= 0))))
    noise = fit_noise(residual, channel.valid)
    rows = noise.usable(channel.valid) & use
    noise = noise.levelled(residual, velocity, rows).scaled_on(residual, velocity, rows)
    count = int(use.sum())
    freedom = max(count - scale.size, count // 4)
    return noise.with_deviation(seen[use], float(np.sqrt(count / max(freedom, 1))))


def _without_outliers(seen: FloatArray, unseen: FloatArray, block: IntArray, use: BoolArray) -> FloatArray:
    """What a fit leaves in rows that it has not seen, without blocks that no other block can predict.

    A place that was visited once cannot be predicted from the rest: that is no noise. (rows,) each, `use`: rows that
    were held out.
    """
    count = int(block.max(initial=0)) + 1
    power = [np.bincount(block[use], r[use] ** 2, count) for r in (unseen, seen)]
    seen_at_all = power[1] > 0.0
    if not seen_at_all.any():
        return unseen
    ratio = np.sqrt(np.divide(power[0], power[1], out=np.ones(count), where=seen_at_all))
    usual = float(np.median(ratio[seen_at_all]))
    alone = use & (ratio > LONELY * usual)[block]
    return np.where(alone, usual * seen, unseen)


# ---- The dictionary --------------------------------------------------------------------------------


RIDGE_LIBRARY = 1e-9
RIDGE_CURVE = {"plain": 3e-5}
RIDGE_OTHER_CURVE = 3e-3
"""On columns of unit norm. Knots that a training fold never visits otherwise ruin the held-out score."""
SHARED = ""
"""In place of the channel in the name of a base coefficient that several channels share."""


@dataclass(frozen=True)
class Rows:
    """One channel of the dictionary: whitened left side (n,) and columns (n, p) of the coefficients `index`.

    `weight` (n,): 1 / level of the noise. `time` s and `fold` (n,) of its usable rows; `fold` -1: guard between blocks.
    `block` numbers the blocks.
    """

    channel: Channel
    noise: Noise
    usable: BoolArray
    weight: FloatArray
    time: FloatArray
    block: IntArray
    fold: IntArray
    left: FloatArray
    columns: FloatArray
    index: IntArray


@dataclass(frozen=True)
class Dictionary:
    """Base, known and free groups of one joint on whitened rows. Physical coefficient = scaled / `norm` (p,).

    `precision` (p,): 1 / variance of a coefficient around zero, physical units, of base columns with a prior.
    `base`: coefficients that every selection holds, of the base columns (`base_names`: channel, name) and of `known`.
    """

    equations: JointEquations
    rows: Mapping[str, Rows]
    base: IntArray
    base_names: tuple[tuple[str, str], ...]
    known: tuple[Group, ...]
    groups: tuple[Group, ...]
    norm: FloatArray
    ridge: FloatArray
    precision: FloatArray

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.norm.size)

    def base_index(self, channel: str, name: str) -> int | None:
        """The coefficient of a base column, None if the channel has none of that name."""
        for key in ((channel, name), (SHARED, name)):
            if key in self.base_names:
                return self.base_names.index(key)
        return None

    def rescaled(self, scales: Mapping[str, float]) -> Dictionary:
        """The same rows in units in which the scale coefficients a, b of the channels are 1 (see `equations`)."""
        rows = {
            name: replace(
                part,
                columns=part.columns * self.norm[part.index] * scales.get(name, 1.0),
                noise=part.noise.divided(scales.get(name, 1.0)),
            )
            for name, part in self.rows.items()
        }
        return _normed(replace(self, rows=rows, equations=self.equations.with_scales(scales)))

    def with_candidates(self, candidates: Sequence[Candidate]) -> Dictionary:
        """This dictionary with more groups behind its own."""
        size, groups = self.size, []
        for candidate in candidates:
            groups.append(group_of(candidate, size))
            size += groups[-1].index.size
        rows = {}
        norm = np.concatenate([self.norm, np.zeros(size - self.size)])
        white = [self.whitened(candidate.columns, candidate.reads) for candidate in candidates]
        for name, part in self.rows.items():
            more = [(g, w[name]) for g, w in zip(groups, white, strict=True) if name in w]
            columns = np.concatenate([part.columns, *(w for _, w in more)], axis=1) if more else part.columns
            rows[name] = replace(part, columns=columns, index=np.concatenate([part.index, *(g.index for g, _ in more)]))
            for group, value in more:
                norm[group.index] += (value**2).sum(axis=0)
        fresh = np.arange(self.size, size)
        norm[fresh] = np.sqrt(norm[fresh])
        norm[norm == 0.0] = 1.0
        for part in rows.values():
            part.columns[:, part.index >= self.size] /= norm[part.index[part.index >= self.size]]
        ridge = np.concatenate([self.ridge, np.full(fresh.size, RIDGE_LIBRARY)])
        precision = np.concatenate([self.precision, np.zeros(fresh.size)])
        return replace(self, rows=rows, groups=(*self.groups, *groups), norm=norm, ridge=ridge, precision=precision)

    def louder(self, factors: Mapping[str, float]) -> Dictionary:
        """The same rows with the noise of each channel taken `factors` times larger."""
        rows = {
            name: replace(
                part,
                left=part.left / factors.get(name, 1.0),
                columns=part.columns * self.norm[part.index] / factors.get(name, 1.0),
                noise=part.noise.divided(1.0 / factors.get(name, 1.0)),
            )
            for name, part in self.rows.items()
        }
        return _normed(replace(self, rows=rows))

    def with_base(self, equations: JointEquations, channel: str) -> Dictionary:
        """The same with the base columns that `equations` has for one channel, whose scale is 1."""
        part = replace(self.rows[channel], channel=equations.channels[channel])
        rows = {n: replace(p, columns=p.columns * self.norm[p.index]) for n, p in {**self.rows, channel: part}.items()}
        white = part.weight[:, None] * part.noise.whiten(part.channel.base_matrix)[part.usable]
        own = base_of(part.channel, self.base_names)
        place = [int(np.flatnonzero(part.index == i)[0]) for i in own]
        rows[channel].columns[:, place] = white
        return _normed(replace(self, rows=rows, equations=equations))

    def without_rows(self, blind: Mapping[str, BoolArray]) -> Dictionary:
        """The same without some rows of channels; `blind` (rows of the channel,) by channel."""
        rows = {}
        for name, part in self.rows.items():
            columns = part.columns * self.norm[part.index]
            if name in blind:
                keep = ~blind[name][part.usable]
                usable = part.usable & ~blind[name]
                part = replace(part, usable=usable, time=part.time[keep], block=part.block[keep], fold=part.fold[keep])
                part, columns = replace(part, left=part.left[keep], weight=part.weight[keep]), columns[keep]
            rows[name] = replace(part, columns=columns)
        return _normed(replace(self, rows=rows))

    @property
    def noises(self) -> dict[str, Noise]:
        """The noise of each channel."""
        return {name: part.noise for name, part in self.rows.items()}

    def whitened(self, columns: Columns, reads: str = "") -> dict[str, FloatArray]:
        """Raw columns (n, k) at the rate of the recording as whitened rows by channel, physical units, (rows, k)."""
        found = {}
        for name, raw in self.equations.rows_of(columns, reads).items():
            part = self.rows[name]
            found[name] = np.asarray(part.weight[:, None] * part.noise.whiten(raw)[part.usable])
        return found

    def rows_touched(self, group: Group) -> int:
        """Whitened rows of the channels that a group acts on."""
        touched = [rows.left.size for name, rows in self.rows.items() if name in group.channels]
        return sum(touched or (rows.left.size for rows in self.rows.values()))


def build(
    equations: JointEquations,
    candidates: Iterable[Candidate],
    fixed: Sequence[Candidate] = (),
    noises: Mapping[str, Noise] | None = None,
) -> Dictionary:
    """Filters, whitens and norms everything. `fixed` joins the base: what the model holds already, as far as it acts on
    a channel of this recording.

    `noises`: reuse these; else they are fitted on the richest model.
    """
    fixed = [candidate for candidate in fixed if candidate.columns]
    layout = _Layout(equations, candidates, fixed)
    rows: dict[str, Rows] = {}
    for name, channel in equations.channels.items():
        raw, index = layout.raw(channel)
        velocity = equations.states.motor_velocity[:: channel.band.step]
        noise = noises[name] if noises is not None else rich_noise(channel, raw, velocity)
        rows[name] = _rows(channel, noise, raw, index, velocity)
    norm = _norm(rows, layout.size)
    for part in rows.values():
        np.divide(part.columns, norm[part.index], out=part.columns)
    ridge, precision = layout.ridge(), layout.precision()
    groups = layout.groups
    known, free = tuple(groups[: len(fixed)]), tuple(groups[len(fixed) :])
    return Dictionary(equations, rows, layout.base, tuple(layout.base_names), known, free, norm, ridge, precision)


def _key(channel: str, base: Base) -> tuple[str, str]:
    return (base.owner or (SHARED if base.shared else channel)), base.name


def base_of(channel: Channel, names: Sequence[tuple[str, str]]) -> IntArray:
    """Coefficients of a channel's base columns, in their order."""
    return np.array([names.index(_key(channel.name, base)) for base in channel.base], dtype=np.int64)


class _Layout:
    """Which coefficient is whose."""

    def __init__(self, equations: JointEquations, candidates: Iterable[Candidate], fixed: Sequence[Candidate]) -> None:
        self.equations = equations
        self.base_names = list(dict.fromkeys(_key(n, base) for n, c in equations.channels.items() for base in c.base))
        self.groups: list[Group] = []
        self.size = len(self.base_names)
        self._columns = {n: [c.base_matrix] for n, c in equations.channels.items()}
        self._index = {n: [base_of(c, self.base_names)] for n, c in equations.channels.items()}
        for candidate in chain(fixed, candidates):  # filtered at once, so that the raw columns can go
            group = group_of(candidate, self.size)
            self.groups.append(group)
            self.size += group.index.size
            sent = candidate.rows
            for name, rows in (equations.rows_of(candidate.columns, candidate.reads) if sent is None else sent).items():
                self._columns[name].append(rows)
                self._index[name].append(group.index)
        known = len(self.base_names) + sum(group.index.size for group in self.groups[: len(fixed)])
        self.base = np.arange(known)

    def raw(self, channel: Channel) -> tuple[FloatArray, IntArray]:
        """Filtered columns (rows, p) of a channel and their coefficients; may be asked for once."""
        return np.concatenate(self._columns.pop(channel.name), axis=1), np.concatenate(self._index[channel.name])

    def precision(self) -> FloatArray:
        """1 / variance of each coefficient by the priors of the base."""
        priors = {_key(n, base): base.prior for n, channel in self.equations.channels.items() for base in channel.base}
        found = np.zeros(self.size)
        found[: len(self.base_names)] = [1.0 / priors[key] ** 2 for key in self.base_names]
        return found

    def ridge(self) -> FloatArray:
        """Ridge of each coefficient, for columns of unit norm."""
        ridge = np.full(self.size, RIDGE_LIBRARY)
        for group in self.groups:
            if group.curve is not None:
                ridge[group.index] = RIDGE_CURVE.get(group.curve.kind, RIDGE_OTHER_CURVE)
        return ridge


def _norm(rows: Mapping[str, Rows], size: int) -> FloatArray:
    norm = np.sqrt(sum((_squares(part, size) for part in rows.values()), np.zeros(size)))
    norm[norm == 0.0] = 1.0
    return np.asarray(norm)


def _normed(raw: Dictionary) -> Dictionary:
    """A dictionary whose columns are in physical units, normed."""
    norm = _norm(raw.rows, raw.size)
    for part in raw.rows.values():
        np.divide(part.columns, norm[part.index], out=part.columns)
    return replace(raw, norm=norm)


def _rows(channel: Channel, noise: Noise, raw: FloatArray, index: IntArray, velocity: FloatArray) -> Rows:
    usable = noise.usable(channel.valid) & channel.fitted
    time = channel.time[usable]
    block, fold = Blocks().of(time)
    weight = 1.0 / noise.level(velocity[usable])
    left, columns = weight * noise.whiten(channel.left)[usable], weight[:, None] * noise.whiten(raw)[usable]
    return Rows(channel, noise, usable, weight, time, block, fold, left, columns, index)


def _squares(part: Rows, size: int) -> FloatArray:
    squares = np.zeros(size)
    np.add.at(squares, part.index, (part.columns**2).sum(axis=0))
    return squares
