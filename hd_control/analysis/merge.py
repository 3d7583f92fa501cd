"""Two effects on one channel each, or one effect on both?

A gain error of the gauge looks like a payload on the link and like a wrong torque constant on the rotor, until the
scales a and b of the balances are those of the gain error.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from hd_control.analysis.search import Search, Selection
from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import LINK, MOTOR

MARGIN = 3.0
"""nats that the single effect must be better, penalties included."""
ROUNDS = 4


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
    for _ in range(ROUNDS):
        found = grams.fitted(scales)
        if all(abs(found[n] / scales[n] - 1.0) < 1e-4 for n in scales):
            break
        scales = {n: found[n] if 0.2 < found[n] < 5.0 else scales[n] for n in scales}
    loss = grams.loss(scales)
    return loss + search.criterion(selection) - search.scores.loss(search.index(selection)), scales


class _Grams:
    """Gram matrices of a selection by channel and fold."""

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
