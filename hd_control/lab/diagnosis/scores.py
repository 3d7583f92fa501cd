"""Held-out scores of any selection of groups, from the Gram matrices of the folds.

Loss of a selection: half the whitened squared error on rows that were not used for its fit, in nats, summed over folds.
A prior of a base coefficient counts as one more measurement, spread over the folds: what it absorbs is paid for.

    G_f = sum x x^T + P / F    r_f = sum x y    s_f = sum y^2        whitened rows x, y of fold f, columns of unit norm
    c_f = (sum_{g != f} G_g + R)^-1 sum_{g != f} r_g                 fitted without fold f
    loss = 1/2 sum_f (s_f - 2 c_f^T r_f + c_f^T G_f c_f)             nats

F folds; P = diag(precision / norm^2) of the priors, R = diag(ridge).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.dictionary import Blocks, Dictionary, Rows


@dataclass(frozen=True)
class Part:
    """One channel by folds: Gram matrices (folds, k, k), right sides (folds, k) of its columns, squares (folds,)."""

    gram: FloatArray
    right: FloatArray
    squares: FloatArray

    @classmethod
    def of(cls, rows: Rows) -> Part:
        """From the rows themselves."""
        folds = Blocks().folds
        found = [(rows.columns[rows.fold == f], rows.left[rows.fold == f]) for f in range(folds)]
        gram, right = (np.stack(each) for each in zip(*((x.T @ x, x.T @ y) for x, y in found), strict=True))
        return cls(gram, right, np.array([y @ y for _, y in found]))

    def scaled(self, columns: FloatArray, left: float) -> Part:
        """The same with columns multiplied by `columns` (k,) and the left side by `left`."""
        gram = self.gram * columns[:, None] * columns[None, :]
        return Part(gram, self.right * columns * left, self.squares * left**2)

    def replaced(self, rows: Rows, places: IntArray) -> Part:
        """The same after the columns at some places have changed to those of `rows`."""
        gram, right = self.gram.copy(), self.right.copy()
        for fold in range(len(self.squares)):
            mine = rows.fold == fold
            x = rows.columns[mine]
            cross = x.T @ x[:, places]
            gram[fold][:, places] = cross
            gram[fold][places, :] = cross.T
            right[fold][places] = x[:, places].T @ rows.left[mine]
        return Part(gram, right, self.squares)

    def extended(self, rows: Rows) -> Part:
        """The same with more columns behind, those that `rows` has beyond this part."""
        folds, old = self.right.shape
        size = rows.index.size
        gram, right = np.zeros((folds, size, size)), np.zeros((folds, size))
        gram[:, :old, :old], right[:, :old] = self.gram, self.right
        return Part(gram, right, self.squares).replaced(rows, np.arange(old, size))


class Scores:
    """Fold-wise Gram matrices of a dictionary: (folds, p, p), right sides (folds, p), squares (folds,).

    `parts`: those of the channels, if they are known already.
    """

    def __init__(self, dictionary: Dictionary, parts: Mapping[str, Part] | None = None) -> None:
        self.dictionary = dictionary
        self.parts = {n: Part.of(rows) for n, rows in dictionary.rows.items()} if parts is None else dict(parts)
        folds, size = Blocks().folds, dictionary.size
        self.gram = np.zeros((folds, size, size))
        self.right = np.zeros((folds, size))
        self.squares = np.zeros(folds)
        for name, part in self.parts.items():
            index = dictionary.rows[name].index
            self.gram[:, index[:, None], index[None, :]] += part.gram
            self.right[:, index] += part.right
            self.squares += part.squares
        self.ridge = dictionary.ridge
        self._prior = dictionary.precision / dictionary.norm**2
        self.gram[:, np.arange(size), np.arange(size)] += self._prior / folds
        self.gram_all = self.gram.sum(axis=0)
        self.right_all = self.right.sum(axis=0)
        self.rest = self.gram_all - self.gram

    def extended(self, dictionary: Dictionary) -> Scores:
        """The scores of the same dictionary with more groups behind: only the new columns are multiplied."""
        return Scores(dictionary, {name: part.extended(dictionary.rows[name]) for name, part in self.parts.items()})

    def moved(
        self,
        dictionary: Dictionary,
        columns: Mapping[str, float] | None = None,
        left: Mapping[str, float] | None = None,
        fresh: Collection[str] = (),
        replaced: Mapping[str, IntArray] | None = None,
    ) -> Scores:
        """The scores of a dictionary that was made from this one without new columns; what did not change is kept.

        By channel: its columns and its left side were multiplied by a number (`columns`, `left`), it has other rows
        (`fresh`), or some of its coefficients have other columns (`replaced`).
        """
        old, parts = self.dictionary, {}
        for name, rows in dictionary.rows.items():
            if name in fresh:
                parts[name] = Part.of(rows)
                continue
            factor = (columns or {}).get(name, 1.0) * old.norm[rows.index] / dictionary.norm[rows.index]
            parts[name] = self.parts[name].scaled(factor, (left or {}).get(name, 1.0))
            if name in (replaced or {}):
                assert replaced is not None
                parts[name] = parts[name].replaced(rows, np.flatnonzero(np.isin(rows.index, replaced[name])))
        return Scores(dictionary, parts)

    def _need(self, index: IntArray) -> None:
        """Fills in what is asked for, in scores that do not have all from the start."""

    def train(self, index: IntArray) -> FloatArray:
        """Coefficients (folds, k) of a selection, each fitted on the other folds."""
        self._need(index)
        left = self.rest[:, index[:, None], index[None, :]]
        left[:, np.arange(index.size), np.arange(index.size)] += self.ridge[index]
        right = self.right_all[index] - self.right[:, index]
        return np.asarray(np.linalg.solve(left, right[..., None])[..., 0])

    def fit(self, index: IntArray) -> FloatArray:
        """Coefficients (k,) of a selection, fitted on all folds."""
        self._need(index)
        left = self.gram_all[np.ix_(index, index)].copy()
        left[np.diag_indices(index.size)] += self.ridge[index]
        return np.asarray(np.linalg.solve(left, self.right_all[index]))

    def loss(self, index: IntArray) -> float:
        """Held-out loss of a selection, nats."""
        c = self.train(index)
        grid = np.ix_(index, index)
        total = 0.0
        for fold in range(len(self.squares)):
            quadratic = c[fold] @ self.gram[fold][grid] @ c[fold]
            total += 0.5 * (self.squares[fold] - 2.0 * c[fold] @ self.right[fold][index] + quadratic)
        return float(total)

    def gains(self, index: IntArray, groups: Sequence[Group]) -> FloatArray:
        """Held-out gain of each group added to a selection, nats. Elimination of the selection s, fold by fold:

            B = (A_ss + R_s)^-1 A_sj    c = (A_ss + R_s)^-1 a_s            A, a: Gram matrix, right side of other folds
            d = (A_jj - A_js B + R_j)^-1 (a_j - A_js c)                    coefficients of group j beside s
            gain = d^T (t_j - T_js c - B^T (t_s - T_ss c)) - 1/2 d^T (T_jj - T_js B - B^T T_sj + B^T T_ss B) d

        with T, t those of the fold itself: the loss of s alone less that of s and j, each fitted without the fold.
        """
        self._need(index)
        gain = np.zeros(len(groups))
        batches = [(place, np.stack([groups[i].index for i in place])) for place in _by_width(groups)]
        for fold in range(len(self.squares)):
            rows, g, r = self.rest[fold][index], self.gram[fold], self.right[fold]
            s = rows[:, index].copy()
            s[np.diag_indices(index.size)] += self.ridge[index]
            rest = self.right_all - r
            solved = np.linalg.solve(s, np.concatenate([rows, rest[index, None]], axis=1))
            b, c = solved[:, :-1], solved[:, -1]
            tested, seen = g[index], g[np.ix_(index, index)] @ b
            train_right = rest - rows.T @ c
            test_right = r - tested.T @ c - b.T @ (r[index] - g[np.ix_(index, index)] @ c)
            half = seen - 2.0 * tested
            for place, j in batches:
                block = (j[:, :, None], j[:, None, :])
                bj = b[:, j]
                train = self.rest[fold][block] - np.einsum("kgi,kgj->gij", bj, rows[:, j])
                test = g[block] + np.einsum("kgi,kgj->gij", bj, half[:, j])
                train[:, np.arange(j.shape[1]), np.arange(j.shape[1])] += self.ridge[j]
                d = np.linalg.solve(train, train_right[j][..., None])[..., 0]
                quadratic = np.einsum("gi,gij,gj->g", d, test, d)
                gain[place] += np.einsum("gi,gi->g", d, test_right[j]) - 0.5 * quadratic
        return gain

    def channel_losses(self, index: IntArray) -> dict[str, float]:
        """Held-out loss of a selection by channel, nats."""
        c = np.zeros((len(self.squares), self.dictionary.size))
        c[:, index] = self.train(index)
        found = {}
        for name, part in self.parts.items():
            own = c[:, self.dictionary.rows[name].index]
            cross = np.einsum("fi,fi->f", own, part.right)
            found[name] = 0.5 * float(
                (part.squares - 2.0 * cross + np.einsum("fi,fij,fj->f", own, part.gram, own)).sum()
            )
        return found

    def block_losses(self, index: IntArray) -> FloatArray:
        """Held-out loss of a selection by block of time, (blocks,), channels added."""
        c = self.train(index)
        scaled = np.zeros((len(self.squares), self.dictionary.size))
        scaled[:, index] = c
        count = 1 + max(int(part.block.max(initial=0)) for part in self.dictionary.rows.values())
        losses = np.zeros(count)
        for part in self.dictionary.rows.values():
            mine = np.flatnonzero(np.any(scaled[:, part.index] != 0.0, axis=0))
            x = part.columns[:, mine]
            for fold in range(len(self.squares)):
                rows = part.fold == fold
                error = part.left[rows] - x[rows] @ scaled[fold, part.index[mine]]
                np.add.at(losses, part.block[rows], 0.5 * error**2)
        prior = 0.5 * float(np.mean(c**2 @ self._prior[index]))
        losses[losses > 0.0] += prior / max(1, int(np.count_nonzero(losses)))
        return losses


class LazyScores(Scores):
    """The same of rows that all columns share, without products that nobody asks for: those within a group at once,
    those of a column with all others when it is selected."""

    def __init__(self, dictionary: Dictionary, old: LazyScores | None = None) -> None:
        self.dictionary, self.parts = dictionary, {}
        folds, size = Blocks().folds, dictionary.size
        self._folds = {n: [np.flatnonzero(p.fold == f) for f in range(folds)] for n, p in dictionary.rows.items()}
        self.gram, self.right = np.zeros((folds, size, size)), np.zeros((folds, size))
        self.squares, self.ridge = np.zeros(folds), dictionary.ridge
        self._prior = dictionary.precision / dictionary.norm**2
        self._known = np.zeros(size, dtype=bool)
        fresh = np.arange(size)
        if old is not None:
            n = old.dictionary.size
            self.gram[:, :n, :n], self.right[:, :n], fresh = old.gram, old.right, fresh[n:]
            self.squares = old.squares
        for name, part in dictionary.rows.items():
            for f, rows in enumerate(self._folds[name]):
                x, y = part.columns[rows[:, None], fresh], part.left[rows]
                self.right[f, fresh] += x.T @ y
                self.squares[f] += 0.0 if old is not None else y @ y
        self.gram[:, fresh, fresh] += self._prior[fresh] / folds
        for group in dictionary.groups:
            if group.index[0] >= fresh[0] if fresh.size else False:
                self._fill(group.index, group.index, prior=True)
        self.gram_all, self.right_all = self.gram.sum(axis=0), self.right.sum(axis=0)
        self.rest = self.gram_all - self.gram
        if old is not None:
            self._need(np.flatnonzero(old._known))

    def extended(self, dictionary: Dictionary) -> LazyScores:
        """The scores of the same dictionary with more groups behind."""
        return LazyScores(dictionary, self)

    def _fill(self, some: IntArray, others: IntArray, prior: bool = False) -> None:
        """Products of some columns with others, by fold."""
        for f in range(self.gram.shape[0]):
            block = np.zeros((some.size, others.size))
            for name, part in self.dictionary.rows.items():
                rows = self._folds[name][f]
                block += part.columns[rows[:, None], some].T @ (
                    part.columns[rows] if others.size == self.dictionary.size else part.columns[rows[:, None], others]
                )
            same = some[:, None] == others[None, :]
            block += same * (self._prior[some] / self.gram.shape[0])[:, None]
            self.gram[f][np.ix_(some, others)] = block
            self.gram[f][np.ix_(others, some)] = block.T

    def _need(self, index: IntArray) -> None:
        missing = index[~self._known[index]]
        if missing.size == 0:
            return
        self._fill(missing, np.arange(self.dictionary.size))
        self._known[missing] = True
        self.gram_all[missing] = self.gram[:, missing].sum(axis=0)
        self.gram_all[:, missing] = self.gram[:, :, missing].sum(axis=0)
        self.rest[:, missing] = self.gram_all[missing] - self.gram[:, missing]
        self.rest[:, :, missing] = self.gram_all[:, missing] - self.gram[:, :, missing]

    def channel_losses(self, index: IntArray) -> dict[str, float]:
        """Held-out loss of a selection by channel, nats."""
        c, found = self.train(index), {}
        for name, part in self.dictionary.rows.items():
            errors = (part.left[r] - part.columns[r[:, None], index] @ c[f] for f, r in enumerate(self._folds[name]))
            found[name] = 0.5 * float(sum(e @ e for e in errors))
        return found


def _by_width(groups: Sequence[Group]) -> list[IntArray]:
    """Places of the groups that have equally many coefficients, together."""
    widths = np.array([group.index.size for group in groups])
    return [np.flatnonzero(widths == width) for width in np.unique(widths)]
