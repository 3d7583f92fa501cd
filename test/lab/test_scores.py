"""Held-out scores from Gram matrices against weighted least squares on the rows themselves, solved densely.

Whatever decides between effects will rest on these numbers or on others like them; here is what they must be.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from plain_joint import equations
from test_dictionary import CANDIDATES, columns

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.torsion import with_damping
from hd_control.lab.diagnosis.candidates import Candidate
from hd_control.lab.diagnosis.dictionary import Blocks, Dictionary, base_of, build
from hd_control.lab.diagnosis.scores import Scores

FOLDS = Blocks().folds
MORE = (
    Candidate("wide", {LINK: columns(11, 4)}),
    Candidate("narrow", {MOTOR: columns(12, 1)}),
    Candidate("pair", {MOTOR: columns(13), TRANSMISSION: 1e-6 * columns(14)}),
)


@lru_cache(maxsize=1)
def dictionary() -> Dictionary:
    """The plain joint with five candidates, one of which explains a little of the noise by chance."""
    return build(equations(), (*CANDIDATES, *MORE))


@lru_cache(maxsize=1)
def scores() -> Scores:
    return Scores(dictionary())


def dense(fold: int | None, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whitened rows (n, k) and left sides (n,) of a fold, of all others if it is negative: -1 - fold; None: of all."""
    d, rows, left = dictionary(), [], []
    for part in d.rows.values():
        if fold is None:
            mine = part.fold >= 0
        else:
            mine = part.fold == fold if fold >= 0 else (part.fold >= 0) & (part.fold != -1 - fold)
        whole = np.zeros((int(mine.sum()), d.size))
        whole[:, part.index] = part.columns[mine]
        rows.append(whole[:, index])
        left.append(part.left[mine])
    return np.concatenate(rows), np.concatenate(left)


def solved(fold: int | None, index: np.ndarray) -> np.ndarray:
    """Ridge and priors as further rows: sqrt(weight) c = 0. A fold that is held out takes its share of the priors."""
    d = dictionary()
    x, y = dense(fold, index)
    share = 1.0 if fold is None else (FOLDS - 1.0) / FOLDS
    prior = share * d.precision[index] / d.norm[index] ** 2
    extra = np.diag(np.sqrt(d.ridge[index] + prior))
    return np.linalg.lstsq(np.concatenate([x, extra]), np.concatenate([y, np.zeros(index.size)]), rcond=None)[0]


SELECTIONS = ((), (0,), (0, 1), (1, 2, 4), (0, 1, 2, 3, 4))


def index_of(selection: tuple[int, ...]) -> np.ndarray:
    groups = dictionary().groups
    return np.concatenate([dictionary().base, *(groups[i].index for i in selection)])


@pytest.mark.parametrize("selection", SELECTIONS)
def test_coefficients_are_those_of_dense_least_squares(selection: tuple[int, ...]) -> None:
    """1e-6: Gram matrices square the condition of the rows."""
    index = index_of(selection)
    np.testing.assert_allclose(scores().fit(index), solved(None, index), rtol=1e-5, atol=1e-6)
    train = scores().train(index)
    for fold in range(FOLDS):
        np.testing.assert_allclose(train[fold], solved(-1 - fold, index), rtol=1e-5, atol=1e-6)


def loss_by_hand(index: np.ndarray) -> float:
    """Half the squared error of each fold by coefficients of the others; a prior is a measurement spread over folds."""
    d, total = dictionary(), 0.0
    prior = d.precision[index] / d.norm[index] ** 2 / FOLDS
    for fold in range(FOLDS):
        c = solved(-1 - fold, index)
        x, y = dense(fold, index)
        total += 0.5 * float(np.sum((y - x @ c) ** 2) + np.sum(prior * c**2))
    return total


@pytest.mark.parametrize("selection", SELECTIONS)
def test_the_loss_is_the_squared_error_on_rows_that_were_held_out(selection: tuple[int, ...]) -> None:
    assert scores().loss(index_of(selection)) == pytest.approx(loss_by_hand(index_of(selection)), rel=1e-7)


@pytest.mark.parametrize("selection", SELECTIONS[:-1])
def test_gains_by_elimination_are_differences_of_losses(selection: tuple[int, ...]) -> None:
    """All groups at once, of different widths, against one fit for each. To 1e-6 nats of thousands."""
    free = [i for i in range(len(dictionary().groups)) if i not in selection]
    found = scores().gains(index_of(selection), [dictionary().groups[i] for i in free])
    before = scores().loss(index_of(selection))
    expected = [before - scores().loss(index_of((*selection, i))) for i in free]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert max(expected) > min(expected), "they differ, so the order matters"


def test_losses_by_channel_and_by_block_add_up() -> None:
    index = index_of((0, 1))
    d, c = dictionary(), scores().train(index)
    prior = 0.5 * float(np.sum(c**2 @ (d.precision[index] / d.norm[index] ** 2))) / FOLDS
    whole = scores().loss(index)
    assert sum(scores().channel_losses(index).values()) == pytest.approx(whole - prior, rel=1e-9)
    blocks = scores().block_losses(index)
    assert blocks.sum() == pytest.approx(whole, rel=1e-9)
    # A block by hand: the rotor's rows of one block and the coefficients of the folds that do not hold it.
    number, by_hand = 20, 0.0
    for part in d.rows.values():
        rows = (part.block == number) & (part.fold >= 0)
        scaled = np.zeros(d.size)
        scaled[index] = c[number % FOLDS]
        by_hand += 0.5 * float(np.sum((part.left[rows] - part.columns[rows] @ scaled[part.index]) ** 2))
    share = prior / np.count_nonzero(blocks)
    assert blocks[number] - share == pytest.approx(by_hand, rel=1e-9)


def test_what_is_held_out_does_not_leak() -> None:
    """Rows of one fold twice as large: the coefficients by which that fold is judged stay, all others move."""
    index, fold = index_of((0, 1)), 2
    spoiled = build(equations(), (*CANDIDATES, *MORE), noises=dictionary().noises)
    for part in spoiled.rows.values():
        part.left[part.fold == fold] *= 2.0
    before, after = scores().train(index), Scores(spoiled).train(index)
    np.testing.assert_allclose(after[fold], before[fold], rtol=1e-9)  # sums without a fold are rounded
    assert all(np.abs(after[f] - before[f]).max() > 1e-3 for f in range(FOLDS) if f != fold)


def test_guard_rows_are_in_no_score() -> None:
    spoiled = build(equations(), (*CANDIDATES, *MORE), noises=dictionary().noises)
    for part in spoiled.rows.values():
        part.left[part.fold < 0] = 1e6
    index = index_of((0, 1))
    again = Scores(spoiled)
    assert again.loss(index) == scores().loss(index)
    np.testing.assert_array_equal(again.fit(index), scores().fit(index))


def test_more_groups_behind_only_multiply_their_own_columns() -> None:
    few = build(equations(), CANDIDATES, noises=dictionary().noises)
    more = few.with_candidates(MORE)
    extended, fresh = Scores(few).extended(more), Scores(more)
    for name in ("gram", "right", "squares"):
        found, expected = getattr(extended, name), getattr(fresh, name)
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("change", ["scales", "louder", "rows", "base"])
def test_scores_that_are_moved_are_those_of_the_new_rows(change: str) -> None:
    old = dictionary()
    if change == "scales":
        scales = {MOTOR: 1.1, LINK: 0.9}
        new = old.rescaled(scales)
        moved = scores().moved(new, columns=scales)
    elif change == "louder":
        quieter = {MOTOR: 0.5}
        new = old.louder({MOTOR: 2.0})
        moved = scores().moved(new, columns=quieter, left=quieter)
    elif change == "rows":
        blind = {LINK: np.arange(old.rows[LINK].channel.time.size) < 700}
        new = old.without_rows(blind)
        moved = scores().moved(new, fresh=blind)
    else:
        new = old.with_base(with_damping(equations(), 1.5e-3), TRANSMISSION)
        own = base_of(new.rows[TRANSMISSION].channel, new.base_names)
        moved = scores().moved(new, replaced={TRANSMISSION: own})
    fresh = Scores(new)
    for name in ("gram", "right", "squares", "gram_all", "right_all", "rest"):
        found, expected = getattr(moved, name), getattr(fresh, name)
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_an_effect_that_is_there_gains_what_its_power_says() -> None:
    """A column with coefficient c of unit norm gains c^2 / 2 nats, give or take c z for its part z in the noise, which
    is a few; without the effect nothing is gained, and chance costs about half a nat. A random column: one that repeats
    is mixed up with those of the base, which are wrong on held-out rows then, and gains more."""
    white = Candidate("white", {MOTOR: np.random.default_rng(5).standard_normal((columns(0).shape[0], 1))})
    d, spoiled = (build(equations(), [white], noises=dictionary().noises) for _ in range(2))
    (group,), part = d.groups, spoiled.rows[MOTOR]
    at = int(np.flatnonzero(part.index == group.index[0])[0])
    part.left[:] += 100.0 * part.columns[:, at]
    (gain,) = Scores(spoiled).gains(d.base, [group])
    inside = float(np.sum(part.columns[part.fold >= 0, at] ** 2))
    assert gain == pytest.approx(0.5 * 100.0**2 * inside, rel=0.05)
    (none,) = Scores(d).gains(d.base, [group])
    assert abs(none) < 5.0
