"""From a task to the selection of effects and curves that the data support: search, then correct what it assumed.

After a first search five assumptions are checked, and what fails is mended before the search goes on: the noise was
estimated well, the laws hold on all rows, shapes are on a grid, stiffness and scales a, b are those of the first guess,
and two effects on one channel each are not one effect on both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hd_control.analysis.cancelling import without_cancelling
from hd_control.analysis.channels import JointEquations
from hd_control.analysis.curves import curves
from hd_control.analysis.dictionary import Dictionary, base_of, build
from hd_control.analysis.fit import Fit
from hd_control.analysis.groups import Candidate, Group, curve_candidates, library_candidates
from hd_control.analysis.merge import merged
from hd_control.analysis.refine import refine
from hd_control.analysis.scores import Scores
from hd_control.analysis.search import Search, Selection, Thresholds
from hd_control.analysis.torsion import LONGEST_DAMPING, with_damping, with_lost_torsion
from hd_control.core.arrays import BoolArray
from hd_control.drive.effect import LINK, MOTOR, TORSION_FAMILY, TRANSMISSION, Context, Effect, Shape

ROUNDS = 2
SECOND_STAGE = ("presliding",)
"""Effects that live in the rows that the first search leaves out."""
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
    """What is asked: the balances of a joint, the library, what the model holds already (effect, shape), and limits."""

    equations: JointEquations
    library: Mapping[str, type[Effect]]
    known: tuple[tuple[type[Effect], Shape], ...] = ()
    context: Context = Context(np.inf, 0.0, 1.0)
    rated_torque: float | None = None
    thresholds: Thresholds = Thresholds()


def prepare(task: Task) -> Dictionary:
    """The dictionary of everything that could be missing, in units in which the baseline's a and b are 1."""
    equations = task.equations
    channels = set(equations.channels)
    names = {effect.name for effect, _ in task.known}
    effects = [e for n, e in task.library.items() if not e.in_every_model and n not in names and n not in SECOND_STAGE]
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


def hunt(task: Task, dictionary: Dictionary | None = None) -> tuple[Search, Selection]:
    """The search in its last state, and what it selected. `dictionary`: that of `prepare`, if it is there already."""
    chase = Chase(task, prepare(task) if dictionary is None else dictionary)
    chase.rescale(())
    chase.correct(chase.search.forward(()))  # so that a curve competes with laws that are not on a grid
    selection = chase.search.run()
    if selection and chase.mend_noise(selection):
        selection = chase.search.run()
    if selection and chase.leave_blind_rows(selection):
        selection = chase.search.run()
    for effect in chase.laws_for_curves(selection):
        selection = chase.try_law(effect, selection)
    for _ in range(ROUNDS):
        if not selection:
            break
        before = {g.name for g in selection}
        selection, moved = chase.correct(selection)
        selection = chase.merge(selection)
        search = chase.search
        selection = search.prune(search.extend(search.forward(search.tidy(selection))))
        if {g.name for g in selection} == before and not moved:
            break
    return chase.search, without_cancelling(chase.search, selection)


class Chase:
    """The dictionary as it is mended, with its scores and search."""

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
