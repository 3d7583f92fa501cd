"""Continuous refinement of the shapes of selected effects: variable projection, one effect at a time.

The linear coefficients of everything selected are eliminated exactly; only the shape moves. Grid-only estimates leave
ghosts: a coarse shape is completed by an innocent companion.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hd_control.analysis.dictionary import Dictionary
from hd_control.analysis.fit import index_of
from hd_control.analysis.groups import Candidate, Group
from hd_control.analysis.scores import Scores
from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import Columns, Shape

MAX_EVALUATIONS = 40


class _Projected:
    """Squared whitened error of a selection without one effect, as a function of that effect's columns."""

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

    def loss(self, columns: Columns) -> tuple[float, FloatArray]:
        """(change of the loss in nats, negative is better; coefficients) when these raw columns are added."""
        width = next(iter(columns.values())).shape[1]
        gram, right = np.zeros((width, width)), np.zeros(width)
        cross = np.zeros((self._index.size, width))
        for name, raw in columns.items():
            if name not in self._parts:
                continue
            residual, selected, place = self._parts[name]
            x = self.dictionary.whitened(name, raw)[self.dictionary.rows[name].fold >= 0]
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
            columns = {n: c for n, c in group.effect.columns(states, shape).items() if n in dictionary.rows}
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
        return projected.loss({n: c for n, c in columns.items() if n in projected.dictionary.rows})[0]

    start = np.clip(code(np.array([float(group.shape[n]) for n in names])), low, high)
    before = objective(start)
    span = np.where(np.isfinite(high - low), high - low, 1.0)
    step = np.where(logs, 0.25, 0.1 * span)
    simplex = np.stack([start, *(start + np.eye(len(names))[i] * step[i] for i in range(len(names)))])
    options = {"maxfev": MAX_EVALUATIONS * len(names), "initial_simplex": np.clip(simplex, low, high)}
    options |= {"xatol": 1e-3, "fatol": 0.05}
    result = minimize(objective, start, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options)
    return shape_of(np.clip(result.x, low, high)) if result.fun < before - 0.1 else None
