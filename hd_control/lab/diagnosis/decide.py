"""What the innovations of a joint say is missing: candidates as responses, noise of a rich fit, search, better shapes.

The first search takes the innovations as they are, white. Then the noise of each sensor is an autoregression of what a
rich fit leaves: the base, shapes of every law, smooth curves, and what the last search selected. An autoregression of a
poorer fit would pass a resonance or an offset for noise, and whitening would hide it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import CHANNELS, Context, Effect, Shape
from hd_control.lab.balances.noise import Noise, fit_noise
from hd_control.lab.diagnosis.candidates import (
    Candidate,
    Group,
    curve_candidates,
    curves,
    library_candidates,
    more_curves,
)
from hd_control.lab.diagnosis.corrections import refine
from hd_control.lab.diagnosis.dictionary import Dictionary, build
from hd_control.lab.diagnosis.fit import Fit
from hd_control.lab.diagnosis.scores import LazyScores
from hd_control.lab.diagnosis.search import Search, Selection, Thresholds
from hd_control.lab.innovations.equations import Innovations

ROUNDS = 5
STILL = 2e-3
"""Relative change of the core's numbers below which its columns stay."""
RICHEST = 30
"""Columns of a curve up to which it joins the rich fit."""
RIDGE = 1e-7
Rows = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Decision:
    """The search in its last state, and what it selected."""

    search: Search
    selection: Selection

    @property
    def fit(self) -> Fit:
        """The selection fitted on all folds."""
        return Fit.of(self.search.dictionary, self.search.scores, self.selection)


@dataclass(frozen=True)
class Question:
    """What is asked: the innovations of a joint, the library, what the model holds (effect, shape), and limits.

    `open`: the balances of which something may be named.
    """

    equations: Innovations
    library: Mapping[str, type[Effect]]
    known: tuple[tuple[type[Effect], Shape], ...] = ()
    context: Context = Context(np.inf, 0.0, 1.0)
    thresholds: Thresholds = Thresholds()
    open: frozenset[str] = frozenset(CHANNELS)


class _Responses:
    """Candidates with their responses; the raw columns are not kept."""

    def __init__(self, question: Question, equations: Innovations) -> None:
        self.equations = equations
        states, names = self.equations.states, {effect.name for effect, _ in question.known}
        effects = [e for n, e in question.library.items() if not e.in_every_model and n not in names]
        effects = [e for e in effects if e.near_reversals is None]
        known = (Candidate(e.name, e.columns(states, shape), e, shape) for e, shape in question.known)
        laws = (c for c in library_candidates(effects, states, CHANNELS, more=True) if question.open & set(c.columns))
        net = [*curves(states, set(question.open)), *more_curves(states, question.open)]
        nets = curve_candidates(net, states, CHANNELS)
        self.rows: dict[int, Rows] = {}
        self.known = [self._sent(candidate) for candidate in known]
        self.free = [self._sent(candidate) for candidate in chain(laws, nets)]
        self.free = [c for c in self.free if self.rows[id(c)]]

    def _sent(self, candidate: Candidate) -> Candidate:
        rows = self.equations.rows_of(candidate.columns, candidate.reads)
        thin = Candidate(
            candidate.name,
            {name: c[:1].copy() for name, c in candidate.columns.items()},
            candidate.effect,
            candidate.shape,
            candidate.curve,
            rows,
        )
        self.rows[id(thin)] = rows
        return thin

    def add(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """More candidates, refined shapes; they stay in the list and in the rich fit."""
        fresh = [self._sent(candidate) for candidate in candidates]
        self.free += fresh
        return fresh

    def rich(self) -> list[Candidate]:
        """What the noise is estimated beside: the known, every third shape of each law, curves of few columns."""
        by_name: dict[str, list[Candidate]] = {}
        for candidate in self.free:
            by_name.setdefault(candidate.name, []).append(candidate)
        some = chain.from_iterable(same[1::3] or same[:1] for same in by_name.values())
        return [*self.known, *(c for c in some if c.curve is None or self._width(c) <= RICHEST)]

    def _width(self, candidate: Candidate) -> int:
        return int(next(iter(candidate.columns.values())).shape[1])

    def noises(self, more: Sequence[Candidate], white: bool) -> dict[str, Noise]:
        """Noise of each sensor's innovations beside the rich fit and `more`; `white`: without its autoregression."""
        channels = self.equations.channels
        rows = [self.rows[id(c)] for c in dict.fromkeys([*self.rich(), *more])]
        x = {n: np.concatenate([c.base_matrix, *(r[n] for r in rows)], axis=1) for n, c in channels.items()}
        norm = np.sqrt(sum((x[n][c.fitted] ** 2).sum(axis=0) for n, c in channels.items()) + 1e-300)
        gram, right, count = RIDGE * np.eye(norm.size), np.zeros(norm.size), 0
        for name, channel in channels.items():
            used = x[name][channel.fitted] / norm
            gram += used.T @ used
            right += used.T @ channel.left[channel.fitted]
            count += len(used)
        theta = np.linalg.solve(gram, right) / norm
        freedom = float(np.sqrt(count / max(count - norm.size, count / 4)))
        velocity = next(iter(channels.values())).band.step
        speed = self.equations.states.motor_velocity[::velocity]
        found = {}
        for name, channel in channels.items():
            residual = (channel.left - x[name] @ theta) * freedom
            noise = fit_noise(residual, channel.fitted)
            noise = replace(noise, lags=0.0 * noise.lags) if white else noise
            used = noise.usable(channel.valid) & channel.fitted
            found[name] = noise.levelled(residual, speed, used).scaled_on(residual, speed, used)
        return found


def decide(question: Question) -> Decision:
    """What is missing, by the innovations."""
    equations, still = question.equations, False
    responses, more = _Responses(question, equations), list[Candidate]()
    names: set[str] = set()
    for round_ in range(ROUNDS):
        noises = responses.noises(more, white=round_ == 0)
        dictionary = build(equations, responses.free, responses.known, noises)
        search = Search(dictionary, LazyScores(dictionary), question.thresholds)
        search, selection, better = _refined(search, search.run())
        found = {group.name for group in selection}
        if not selection or still and found == names:
            break
        names = found
        if round_ == 0:
            more += responses.add(list(better.values()))
        else:  # columns again, from states that know what was selected
            before, equations = equations, _beside(equations, Fit.of(search.dictionary, search.scores, selection))
            still = equations.filter_core.numbers.near(before.filter_core.numbers, STILL)
            responses = _Responses(question, equations)
            more = responses.add([_made(group, equations) for group in selection])
    return Decision(search, selection)


def _beside(equations: Innovations, fit: Fit) -> Innovations:
    """The innovations at the fitted numbers, columns from states that know what was selected."""
    owners = fit.dictionary.base_names
    change = {owner: float(c) for owner, c in zip(owners, fit.coefficients[: len(owners)], strict=True)}
    effects = []
    for group in (*fit.dictionary.known, *fit.selection):
        made = _made(group, equations)
        parts = {n: (column @ fit.coefficients[group.index])[:, None] for n, column in made.columns.items()}
        effects.append((parts, made.reads))
    return equations.beside(change, effects)


def _made(group: Group, equations: Innovations) -> Candidate:
    """The columns of a group from these states."""
    if group.curve is not None:
        return next(curve_candidates([group.curve], equations.states, CHANNELS))
    assert group.effect is not None
    columns = {n: c for n, c in group.effect.columns(equations.states, group.shape).items() if n in CHANNELS}
    return Candidate(group.name, columns, group.effect, group.shape)


def _refined(search: Search, selection: Selection) -> tuple[Search, Selection, dict[str, Candidate]]:
    """Better shapes of what is selected, and the search gone on with them."""
    better = refine(search.dictionary, search.scores, selection)
    if not better:
        return search, selection, {}
    dictionary: Dictionary = search.dictionary.with_candidates(list(better.values()))
    fresh: dict[str, Group] = dict(zip(better, dictionary.groups[-len(better) :], strict=True))
    selection = tuple(fresh.get(group.name, group) for group in selection)
    search = Search(dictionary, search.scores.extended(dictionary), search.thresholds)
    return search, search.prune(search.extend(search.forward(search.tidy(selection)))), better
