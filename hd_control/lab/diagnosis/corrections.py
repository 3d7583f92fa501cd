"""From a task to the selection of effects and curves that the data support: search, then correct what it assumed.

After a first search five assumptions are checked, and what fails is corrected before the search goes on: the noise was
estimated well, the laws hold on all rows, shapes are on a grid, stiffness and scales a, b are those of the first guess,
and two effects on one channel each are not one effect on both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import LINK, MOTOR, TORSION_FAMILY, TRANSMISSION, Columns, Context, Effect, Shape
from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.torsion import LONGEST_DAMPING, with_damping, with_lost_torsion
from hd_control.lab.diagnosis.candidates import Candidate, Group, curve_candidates, curves, library_candidates
from hd_control.lab.diagnosis.dictionary import Dictionary, base_of, build
from hd_control.lab.diagnosis.fit import Fit, index_of
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.search import Search, Selection, Thresholds
from hd_control.lab.innovations.equations import Given

# ---- Two effects that cancel each other on one channel are one effect on another channel -----------
#
# An offset of the gauge stands in the rotor and the link balance; with a friction offset that cancels it on the rotor
# it is a constant torque on the link, which neither name explains.


LEFT = 0.1
"""What is left of two contributions, RMS over the smaller of both, below which they cancel."""


def without_cancelling(search: Search, selection: Selection) -> Selection:
    """The selection with the best curve in place of a cancelling pair; the selection itself if there is none."""
    fit = Fit.of(search.dictionary, search.scores, selection)
    pair = _pair(fit, selection)
    if pair is None:
        return selection
    wide, narrow = pair
    rest = tuple(g for g in selection if g not in pair)
    channels = set(wide.channels) - set(narrow.channels)
    ranking = search.ranking(rest)
    curves = [i for i, g in enumerate(search.groups) if g.is_curve and set(g.channels) <= channels]
    best = max(curves, key=lambda i: float(ranking[i]), default=None)
    if best is None or not search.support(search.groups[best], rest).accepted:
        return selection
    return search.prune(search.extend(search.forward(search.tidy((*rest, search.groups[best])))))


def _pair(fit: Fit, selection: Selection) -> tuple[Group, Group] | None:
    """A group on several channels and one on a part of them that cancels it there."""
    for wide in selection:
        for narrow in selection:
            if wide is narrow or wide.is_curve or narrow.is_curve or not set(narrow.channels) < set(wide.channels):
                continue
            a, b = (_contribution(fit, group, narrow.channels) for group in (wide, narrow))
            if _rms(a + b) < LEFT * min(_rms(a), _rms(b)):
                return wide, narrow
    return None


def _contribution(fit: Fit, group: Group, channels: tuple[str, ...]) -> FloatArray:
    """What a group adds to the whitened rows of some channels."""
    dictionary, found = fit.dictionary, []
    scaled = fit.coefficients * dictionary.norm
    for name in channels:
        part = dictionary.rows[name]
        mine = np.isin(part.index, group.index)
        found.append(part.columns[:, mine] @ scaled[part.index[mine]])
    return np.concatenate(found)


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2))) if x.size else 0.0


# ---- Shapes off the grid: variable projection, one effect at a time --------------------------------
#
# The linear coefficients of everything selected are eliminated exactly; only the shape moves. Shapes of the grid
# alone leave false companions: an effect that is not there fills what a coarse shape leaves.


MAX_EVALUATIONS = 40


class _Projected:
    """Squared whitened error of a selection without one effect, as a function of that effect's columns Z:

    e = y - X c    c = (X^T X + R)^-1 X^T y               X: columns of base and the other effects, once
    S = Z^T Z - Z^T X (X^T X + R)^-1 X^T Z                what of Z the others do not span
    d = S^-1 Z^T e    change of the loss = -1/2 d^T Z^T e
    """

    def __init__(self, dictionary: Dictionary, scores: Scores, rest: tuple[Group, ...]) -> None:
        self.dictionary = dictionary
        index = index_of(dictionary, rest)
        self._chol = np.linalg.cholesky(scores.gram_all[np.ix_(index, index)] + np.diag(scores.ridge[index]))
        self._index = index
        self._parts: dict[str, tuple[FloatArray, FloatArray, np.ndarray]] = {}
        coefficients = np.zeros(dictionary.size)
        coefficients[index] = scores.fit(index)
        for name, part in dictionary.rows.items():
            inside = part.fold >= 0
            columns = np.isin(part.index, index)
            place = np.searchsorted(np.sort(index), part.index[columns])
            order = np.argsort(index)
            selected = part.columns[np.ix_(inside, np.flatnonzero(columns))]
            residual = part.left[inside] - selected @ coefficients[part.index[columns]]
            self._parts[name] = residual, selected, order[place]

    def loss(self, columns: Columns, reads: str = "") -> tuple[float, FloatArray]:
        """(change of the loss in nats, negative is better; coefficients) when these raw columns are added."""
        width = next(iter(columns.values())).shape[1]
        gram, right = np.zeros((width, width)), np.zeros(width)
        cross = np.zeros((self._index.size, width))
        for name, rows in self.dictionary.whitened(columns, reads).items():
            residual, selected, place = self._parts[name]
            x = rows[self.dictionary.rows[name].fold >= 0]
            gram += x.T @ x
            right += x.T @ residual
            cross[place] += selected.T @ x
        half = np.linalg.solve(self._chol, cross)
        gram = gram - half.T @ half
        norm = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram / np.outer(norm, norm) + 1e-9 * np.eye(width)
        solution = np.linalg.solve(scaled, right / norm)
        return -0.5 * float(solution @ (right / norm)), solution / norm


def refine(dictionary: Dictionary, scores: Scores, selection: tuple[Group, ...]) -> dict[str, Candidate]:
    """Better shapes of the selected effects that have a continuous shape, by name; only those that gain."""
    states = dictionary.equations.states
    found: dict[str, Candidate] = {}
    for group in selection:
        if group.effect is None:
            continue
        bounds = group.effect.shape_bounds(group.shape, states)
        if not bounds:
            continue
        rest = tuple(other for other in selection if other is not group)
        projected = _Projected(dictionary, scores, rest)
        shape = _minimise(group, projected, bounds)
        if shape is not None:
            columns = {n: c for n, c in group.effect.columns(states, shape).items() if n in group.channels}
            found[group.name] = Candidate(group.name, columns, group.effect, shape)
    return found


def _minimise(group: Group, projected: _Projected, bounds: Mapping[str, tuple[float, float]]) -> Shape | None:
    """The best shape near the present one, None if it is not better by 0.1 nat."""
    from scipy.optimize import minimize

    assert group.effect is not None
    effect, names = group.effect, list(bounds)
    logs = [low > 0.0 and float(group.shape[n]) > 0.0 for n, (low, _) in bounds.items()]
    states = projected.dictionary.equations.states

    def code(values: FloatArray) -> FloatArray:
        return np.array([np.log(v) if log else v for v, log in zip(values, logs, strict=True)])

    def shape_of(x: FloatArray) -> Shape:
        values = [float(np.exp(v)) if log else float(v) for v, log in zip(x, logs, strict=True)]
        return {**group.shape, **dict(zip(names, values, strict=True))}

    low = code(np.array([bounds[n][0] for n in names]))
    high = code(np.array([bounds[n][1] for n in names]))

    def objective(x: FloatArray) -> float:
        columns = effect.columns(states, shape_of(np.clip(x, low, high)))
        return projected.loss({n: c for n, c in columns.items() if n in group.channels}, effect.reads)[0]

    start = np.clip(code(np.array([float(group.shape[n]) for n in names])), low, high)
    before = objective(start)
    span = np.where(np.isfinite(high - low), high - low, 1.0)
    step = np.where(logs, 0.25, 0.1 * span)
    simplex = np.stack([start, *(start + np.eye(len(names))[i] * step[i] for i in range(len(names)))])
    options = {"maxfev": MAX_EVALUATIONS * len(names), "initial_simplex": np.clip(simplex, low, high)}
    options |= {"xatol": 1e-3, "fatol": 0.05}
    result = minimize(objective, start, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options)
    return shape_of(np.clip(result.x, low, high)) if result.fun < before - 0.1 else None


# ---- Two effects on one channel each, or one effect on both? ---------------------------------------
#
# A gain error of the gauge looks like a payload on the link and like a wrong torque constant on the rotor, until the
# scales a and b of the balances are those of the gain error.


MARGIN = 3.0
"""nats that the single effect must be better, penalties included."""
SCALE_ROUNDS = 4


def merged(search: Search, selection: Selection) -> tuple[Selection, dict[str, float]]:
    """The selection with one effect of several channels in place of one or two others, if that is better; with the
    scales a, b by channel in which it is. The selection itself if nothing is better."""
    library = [group for group in selection if not group.is_curve]
    wide = [g for g in search.groups if not g.is_curve and len(g.channels) > 1]
    names = {group.name for group in selection}
    if not library or not wide or not any(len(g.channels) == 1 for g in library):
        return selection, {}
    best, best_value, best_scales = selection, search.criterion(selection) - MARGIN, {}
    for size in (1, 2):
        for gone in combinations(library, size):
            rest = tuple(g for g in selection if g not in gone)
            touched = {name for g in gone for name in g.channels}
            for group in wide:
                if (
                    group.name in names
                    and group.name not in {g.name for g in gone}
                    or not touched <= set(group.channels)
                ):
                    continue
                value, scales = _criterion(search, (*rest, group))
                if value < best_value:
                    best, best_value, best_scales = (*rest, group), value, scales
    return best, best_scales


def _criterion(search: Search, selection: Selection) -> tuple[float, dict[str, float]]:
    """Criterion of a selection in units in which its own a and b are 1, and these scales."""
    grams = _Grams(search, selection)
    scales = dict.fromkeys(grams.names, 1.0)
    for _ in range(SCALE_ROUNDS):
        found = grams.fitted(scales)
        if all(abs(found[n] / scales[n] - 1.0) < 1e-4 for n in scales):
            break
        scales = {n: found[n] if 0.2 < found[n] < 5.0 else scales[n] for n in scales}
    loss = grams.loss(scales)
    return loss + search.criterion(selection) - search.scores.loss(search.index(selection)), scales


class _Grams:
    """Gram matrices of a selection by channel n and fold f, for any units of the channels.

    In units in which the scale coefficient of channel n is `scales[n]`, its columns are that much larger and its white
    left side is the same: G_f = sum_n scales[n]^2 G_nf, r_f = sum_n scales[n] r_nf. `fitted` gives the scales that come
    out, which are put in again until both agree.
    """

    def __init__(self, search: Search, selection: Selection) -> None:
        self.dictionary, self.scores = search.dictionary, search.scores
        self.index = search.index(selection)
        place = {int(j): i for i, j in enumerate(self.index)}
        folds, size = len(self.scores.squares), self.index.size
        self.names = [n for n in self.dictionary.rows if n in (MOTOR, LINK)]
        self.gram = {n: np.zeros((folds, size, size)) for n in self.dictionary.rows}
        self.right = {n: np.zeros((folds, size)) for n in self.dictionary.rows}
        for name, part in self.dictionary.rows.items():
            mine = np.flatnonzero(np.isin(part.index, self.index))
            where = np.array([place[int(j)] for j in part.index[mine]])
            columns = part.columns[:, mine]
            for fold in range(folds):
                rows = part.fold == fold
                x = columns[rows]
                self.gram[name][fold][np.ix_(where, where)] = x.T @ x
                self.right[name][fold][where] = x.T @ part.left[rows]
        self.prior = np.diag(self.dictionary.precision[self.index] / self.dictionary.norm[self.index] ** 2)
        self.ridge = np.diag(self.dictionary.ridge[self.index])

    def _sums(self, scales: dict[str, float]) -> tuple[FloatArray, FloatArray]:
        gram = sum((scales.get(n, 1.0) ** 2 * g for n, g in self.gram.items()), np.zeros(()))
        right = sum((scales.get(n, 1.0) * r for n, r in self.right.items()), np.zeros(()))
        folds = len(right)
        return np.asarray(gram + self.prior / folds), np.asarray(right)

    def fitted(self, scales: dict[str, float]) -> dict[str, float]:
        """a and b in the units of the dictionary when columns are taken in units scaled by `scales`."""
        gram, right = self._sums(scales)
        c = np.linalg.solve(gram.sum(axis=0) + self.ridge, right.sum(axis=0))
        found = {}
        for name in scales:
            i = self.dictionary.base_index(name, "drive_torque")
            at = None if i is None else int(np.flatnonzero(self.index == i)[0])
            own = 1.0 if at is None else float(c[at] / self.dictionary.norm[self.index[at]])
            found[name] = own * scales[name]
        return found

    def loss(self, scales: dict[str, float]) -> float:
        """Held-out loss, nats."""
        gram, right = self._sums(scales)
        total = 0.0
        for fold, squares in enumerate(self.scores.squares):
            left = gram.sum(axis=0) - gram[fold] + self.ridge
            c = np.linalg.solve(left, right.sum(axis=0) - right[fold])
            total += 0.5 * float(squares - 2.0 * c @ right[fold] + c @ gram[fold] @ c)
        return total


# ---- The search with its corrections ---------------------------------------------------------------


ROUNDS = 2
SCALE_TOLERANCE = 2e-3
LOUDER = 1.05
HIDDEN = 10.0
"""Noise power that a rich fit can hide, per column over row."""
STIFFER = 2e-4
DAMPING_TOLERANCE = 3e-5
REWOUND = 3e-4
"""Change of the spring's torque over the torque scale that is worth new columns."""


@dataclass(frozen=True)
class Task:
    """What is asked: the balances of a joint, the library, what the model holds already (effect, shape), and limits.

    `given` makes what the innovations need beside them; None: there are none.
    """

    equations: JointEquations
    library: Mapping[str, type[Effect]]
    known: tuple[tuple[type[Effect], Shape], ...] = ()
    context: Context = Context(np.inf, 0.0, 1.0)
    rated_torque: float | None = None
    thresholds: Thresholds = Thresholds()
    given: Callable[[], Given] | None = None


def prepare(task: Task) -> Dictionary:
    """The dictionary of everything that could be missing, in units in which the baseline's a and b are 1."""
    equations = task.equations
    channels = set(equations.channels)
    names = {effect.name for effect, _ in task.known}
    missing = [e for n, e in task.library.items() if not e.in_every_model and n not in names]
    effects = [e for e in missing if e.near_reversals is None]
    laws = library_candidates(effects, equations.states, channels)
    nets = curve_candidates(curves(equations.states, channels), equations.states, channels)
    return build(equations, chain(laws, nets), known_candidates(task))


def known_candidates(task: Task) -> list[Candidate]:
    """What the model holds already, as candidates that join the base."""
    states, channels = task.equations.states, task.equations.channels
    return [
        Candidate(e.name, {n: c for n, c in e.columns(states, shape).items() if n in channels}, e, shape)
        for e, shape in task.known
    ]


def search_effects(task: Task, dictionary: Dictionary | None = None) -> tuple[Search, Selection]:
    """The search in its last state, and what it selected. `dictionary`: that of `prepare`, if it is there already."""
    corrected = CorrectedSearch(task, prepare(task) if dictionary is None else dictionary)
    corrected.rescale(())
    corrected.correct(corrected.search.forward(()))  # so that a curve competes with laws that are not on a grid
    selection = corrected.search.run()
    if selection and corrected.mend_noise(selection):
        selection = corrected.search.run()
    if selection and corrected.leave_blind_rows(selection):
        selection = corrected.search.run()
    for effect in corrected.laws_for_curves(selection):
        selection = corrected.try_law(effect, selection)
    for _ in range(ROUNDS):
        if not selection:
            break
        before = {g.name for g in selection}
        selection, moved = corrected.correct(selection)
        selection = corrected.merge(selection)
        search = corrected.search
        selection = search.prune(search.extend(search.forward(search.tidy(selection))))
        if {g.name for g in selection} == before and not moved:
            break
    return corrected.search, without_cancelling(corrected.search, selection)


class CorrectedSearch:
    """The dictionary as it is corrected, with its scores and search."""

    search: Search

    def __init__(self, task: Task, dictionary: Dictionary) -> None:
        self.task = task
        self._wound: set[str] = set()
        self._renew(Scores(dictionary))

    def _renew(self, scores: Scores) -> None:
        self.dictionary, self.scores = scores.dictionary, scores
        self.search = Search(self.dictionary, self.scores, self.task.thresholds)

    def fit(self, selection: Selection) -> Fit:
        """The selection fitted on all folds."""
        return Fit.of(self.dictionary, self.scores, selection)

    def rescale(self, selection: Selection) -> Selection:
        """Units in which a and b of a fit are 1; returns the selection in them."""
        scales = self.fit(selection).scales
        if all(abs(value - 1.0) < SCALE_TOLERANCE for value in scales.values()):
            return selection
        safe = {name: value if 0.2 < value < 5.0 else 1.0 for name, value in scales.items()}
        self._renew(self.scores.moved(self.dictionary.rescaled(safe), columns=safe))
        return selection

    def mend_noise(self, selection: Selection) -> bool:
        """A fit with very many columns leaves too little: takes the noise from what the selection leaves, if larger."""
        left = self.fit(selection).residuals()
        found = {name: 1.4826 * float(np.median(np.abs(r))) for name, r in left.items() if r.size}
        most = {
            n: np.sqrt(1.0 + HIDDEN * p.columns.shape[1] / max(1, p.left.size)) for n, p in self.dictionary.rows.items()
        }
        factors = {name: min(factor, float(most[name])) for name, factor in found.items() if factor > LOUDER}
        if factors:
            quieter = {name: 1.0 / factor for name, factor in factors.items()}
            self._renew(self.scores.moved(self.dictionary.louder(factors), columns=quieter, left=quieter))
            self.rescale(())
        return bool(factors)

    def leave_blind_rows(self, selection: Selection) -> bool:
        """Leaves out the rows at which a selected law does not say how it acts."""
        blind = blind_rows(self.dictionary, selection)
        if blind:
            self._renew(self.scores.moved(self.dictionary.without_rows(blind), fresh=blind))
            self.rescale(())
        return bool(blind)

    def laws_for_curves(self, selection: Selection) -> list[str]:
        """Effects whose law leaves rows out and that could stand where a curve or one of their family was selected."""
        states, left = self.dictionary.equations.states, {n for g in selection if g.is_curve for n in g.channels}
        names = {group.name for group in selection}
        families = {g.effect.family for g in selection if g.effect is not None and g.effect.family}
        left |= {n for g in selection if g.effect is not None and g.effect.family in families for n in g.channels}
        found = [
            group.name
            for group in self.dictionary.groups
            if group.effect is not None
            and group.name not in names
            and left & set(group.effect.blind(states, group.shape))
        ]
        return list(dict.fromkeys(found))

    def try_law(self, name: str, selection: Selection) -> Selection:
        """Searches again without the rows that a law leaves out.

        Returns the new selection if the law takes the place of a curve or of another law, else the old one.
        """
        before = self.dictionary, self.scores, self.search
        shapes = tuple(group for group in self.dictionary.groups if group.name == name)
        self.leave_blind_rows(shapes[:1])
        again = self.search.run()
        curves = [sum(g.is_curve for g in found) for found in (again, selection)]
        gone = {g.name for g in selection} - {g.name for g in again}
        if name in {g.name for g in again} and (curves[0] < curves[1] or curves[0] == curves[1] and gone):
            return again
        self.dictionary, self.scores, self.search = before
        return selection

    def correct(self, selection: Selection) -> tuple[Selection, bool]:
        """Refined shapes, columns for the fitted stiffness, scales. True if anything moved."""
        damped = self._redamp(selection)
        better = self._rewound(selection)
        better |= refine(self.dictionary, self.scores, selection)
        better |= self._misread(selection, better, damped)
        if better:
            self._renew(self.scores.extended(self.dictionary.with_candidates(list(better.values()))))
            fresh = dict(zip(better, self.dictionary.groups[-len(better) :], strict=True))
            selection = tuple(fresh.get(group.name, group) for group in selection)
        return self.rescale(selection), bool(better) or damped

    def _redamp(self, selection: Selection) -> bool:
        """Takes the torsion at the damping that the fit found."""
        damping = self.fit(selection).damping_time
        equations = self.dictionary.equations
        if not np.isfinite(damping) or abs(damping - equations.channels[TRANSMISSION].damping_time) < DAMPING_TOLERANCE:
            return False
        damping = float(np.clip(damping, 0.0, LONGEST_DAMPING))
        dictionary = self.dictionary.with_base(with_damping(equations, damping), TRANSMISSION)
        own = base_of(dictionary.rows[TRANSMISSION].channel, dictionary.base_names)
        self._renew(self.scores.moved(dictionary, replaced={TRANSMISSION: own}))
        return True

    def _rewound(self, selection: Selection) -> dict[str, Candidate]:
        """Columns of the torsion laws for the torque that the damper leaves to the spring beside them."""
        laws = [g for g in selection if g.effect is not None and g.effect.family == TORSION_FAMILY]
        names = {law.name for law in laws}
        if not names or names == self._wound:
            return {}
        self._wound = names
        fit, equations = self.fit(selection), self.dictionary.equations
        states, stiffness = equations.states, fit.torsional_stiffness
        if not np.isfinite(stiffness):
            return {}
        lost = np.zeros(states.time.size)
        for law in laws:
            assert law.effect is not None
            lost -= law.effect.columns(states, law.shape)[TRANSMISSION] @ fit.coefficients[law.index]
        damper = max(0.0, fit.damping_time) * stiffness
        damping = equations.channels[TRANSMISSION].damping_time
        fresh = with_lost_torsion(states, equations.spectral, damping, damper, lost)
        if np.std(fresh.elastic_torque - states.elastic_torque) < REWOUND * states.torque_scale:
            return {}
        self.dictionary = replace(self.dictionary, equations=replace(equations, states=fresh))
        return {law.name: self._again(law, None) for law in laws}

    def _misread(self, selection: Selection, better: Mapping[str, Candidate], damped: bool) -> dict[str, Candidate]:
        """Columns of what the gauge misreads, for the stiffness and the damping that the fit found."""
        compliance, states = 1.0 / self.fit(selection).torsional_stiffness, self.dictionary.equations.states
        if not np.isfinite(compliance):
            return {}
        if abs(compliance / states.torsional_compliance - 1.0) < STIFFER and not damped:
            return {}
        states = replace(states, torsional_compliance=compliance)
        self.dictionary = replace(self.dictionary, equations=replace(self.dictionary.equations, states=states))
        found = {}
        for group in selection:
            if {TRANSMISSION, LINK, MOTOR} <= set(group.channels):
                found[group.name] = self._again(group, better.get(group.name))
        return found

    def _again(self, group: Group, better: Candidate | None) -> Candidate:
        states, channels = self.dictionary.equations.states, self.dictionary.rows
        if group.curve is not None:
            return next(curve_candidates([group.curve], states, channels))
        assert group.effect is not None
        shape = group.shape if better is None else better.shape
        columns = {n: c for n, c in group.effect.columns(states, shape).items() if n in channels}
        return Candidate(group.name, columns, group.effect, shape)

    def merge(self, selection: Selection) -> Selection:
        """One effect on several channels in place of several on one each, where that is as good."""
        better, scales = merged(self.search, selection)
        if better is not selection:
            self._renew(self.scores.moved(self.dictionary.rescaled(scales), columns=scales))
            self.rescale(better)
        return better


def blind_rows(dictionary: Dictionary, selection: Selection) -> dict[str, BoolArray]:
    """Rows (rows of the channel,) that the selected effects leave out, by channel."""
    states = dictionary.equations.states
    found: dict[str, BoolArray] = {}
    for group in selection:
        if group.effect is None:
            continue
        for name, rows in group.effect.blind(states, group.shape).items():
            if name in dictionary.rows:
                channel = dictionary.rows[name].channel
                wide = channel.blurred(rows)
                found[name] = wide | found[name] if name in found else wide
    return found
