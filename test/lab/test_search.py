"""The search on planted rows: what is there is selected, what is not is not, and each price is paid once.

Lean on purpose: the deciding part will be replaced by an innovations form; this is what any such part must do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from plain_joint import equations, planted
from test_dictionary import columns

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.diagnosis.candidates import Candidate, Curve
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.search import Search, Selection, Thresholds

TIME = equations().states.time
ONE = columns(31, 1)
NEAR = ONE + 0.3 * columns(32, 1)
"""Much the same as the first."""
BURST = np.where((TIME > 11.0) & (TIME < 11.6), 1.0, 0.0)[:, None] * np.sin(40.0 * TIME)[:, None]
CURVE = Curve("curve", ("time",), lambda s: {LINK: columns(33, 5)}, np.linspace(0.0, 1.0, 3), "time")
CANDIDATES = (
    Candidate("one", {MOTOR: ONE}),
    Candidate("near", {MOTOR: NEAR}, shape={"grid": 1}),
    Candidate("near", {MOTOR: ONE + 0.6 * columns(34, 1)}, shape={"grid": 2}),
    Candidate("link", {LINK: columns(35, 2)}),
    Candidate("torsion", {TRANSMISSION: 1e-6 * columns(36, 1)}),
    Candidate("burst", {MOTOR: BURST}),
    Candidate("curve", {LINK: columns(33, 5)}, curve=CURVE),
)


@lru_cache(maxsize=8)
def search(*sizes: tuple[str, float]) -> Search:
    """A search on rows that hold the named candidates with these coefficients of unit norm."""
    dictionary = planted(CANDIDATES, dict(sizes))
    return Search(dictionary, Scores(dictionary))


def names(selection: Selection) -> list[str]:
    return sorted(group.name for group in selection)


@pytest.mark.parametrize("there", [(), ("one",), ("link",), ("one", "torsion"), ("link", "one", "torsion"), ("curve",)])
def test_what_was_planted_is_selected_and_nothing_else(there: tuple[str, ...]) -> None:
    """A coefficient of 40 is worth 800 nats."""
    assert names(search(*((name, 40.0) for name in there)).run()) == sorted(there)


def test_too_little_is_not_selected() -> None:
    """36 nats and t = 3.6 on one side of the threshold of 40 nats, 43 on the other."""
    assert names(search(("one", 9.0)).run()) == []
    assert names(search(("one", 9.8)).run()) == ["one"]


def test_of_look_alikes_the_right_one_is_selected() -> None:
    assert names(search(("near", 40.0)).run()) == ["near"]
    (group,) = search(("near", 40.0)).run()
    assert group.shape == {"grid": 1}, "and its right shape"


def test_an_exchange_puts_the_right_one_in_the_place_of_a_look_alike() -> None:
    """Started with the wrong one, forward selection beside it would need both."""
    found = search(("one", 40.0))
    wrong = tuple(group for group in found.groups if group.name == "near")[:1]
    assert names(found.tidy(wrong)) == ["one"]


def test_what_is_no_longer_needed_is_dropped() -> None:
    found = search(("one", 40.0))
    start = tuple(group for group in found.groups if group.name in ("one", "link"))
    assert names(found.tidy(start)) == ["one"]


def test_the_price_of_an_effect_is_paid_once() -> None:
    """Loss plus, for each effect: log 500 / 4 per coefficient, half the log of its shapes, 1.5, and 15 or 25."""
    found, limits = search(("one", 40.0)), Thresholds()
    prices = {"one": (1, 1, 15.0), "link": (2, 1, 15.0), "near": (1, 2, 15.0), "curve": (5, 1, 25.0)}
    assert (limits.effect_penalty, limits.curve_penalty) == (15.0, 25.0)
    for chosen in (("one",), ("link", "one"), ("near", "curve")):
        selection = tuple(next(g for g in found.groups if g.name == name) for name in chosen)
        price = sum(
            0.25 * width * np.log(500.0) + 0.5 * np.log(shapes) + 1.5 + extra
            for width, shapes, extra in (prices[name] for name in chosen)
        )
        loss = found.scores.loss(found.index(selection))
        assert found.criterion(selection) == pytest.approx(loss + price)
    assert found.criterion(()) == found.scores.loss(found.dictionary.base)


def test_the_ranking_is_the_gain_less_the_price() -> None:
    found = search(("one", 40.0))
    ranking, gains = found.ranking(()), found.scores.gains(found.index(()), found.groups)
    np.testing.assert_allclose(ranking, gains - found.penalty)
    one = next(group for group in found.groups if group.name == "one")
    beside = found.ranking((one,))
    held = np.array([group.name == "one" for group in found.groups])
    assert np.isneginf(beside[held]).all() and np.isfinite(beside[~held]).all()


def test_support_counts_blocks_and_what_the_best_of_them_carry() -> None:
    """An effect that is everywhere loses little without its best block, a burst nearly all."""
    found = search(("one", 40.0), ("burst", 40.0))
    one, burst = (next(g for g in found.groups if g.name == name) for name in ("one", "burst"))
    even, uneven = found.support(one, (burst,)), found.support(burst, (one,))
    assert even.t > 5.0 and even.without_best > 0.9 * even.gain and even.accepted
    assert uneven.without_best_three < 0.1 * uneven.gain and uneven.t < even.t
    blocks = found.scores.block_losses(found.index((burst,))) - found.scores.block_losses(found.index((one, burst)))
    assert even.gain == pytest.approx(blocks.sum(), rel=1e-6)


def test_not_more_effects_than_allowed() -> None:
    dictionary = planted(CANDIDATES, {"one": 40.0, "link": 40.0, "torsion": 40.0})
    few = Search(dictionary, Scores(dictionary), Thresholds(most_effects=2))
    assert len(few.forward(())) == 2
    none = Search(dictionary, Scores(dictionary), Thresholds(gain=1e9))
    assert none.run() == ()
    limited = Search(dictionary, Scores(dictionary), groups=[g for g in dictionary.groups if g.name == "link"])
    assert names(limited.run()) == ["link"]


def test_a_weak_effect_beside_a_curve_on_its_channel_is_part_of_the_curve() -> None:
    found = search(("curve", 60.0), ("link", 12.0))
    both = tuple(group for group in found.groups if group.name in ("curve", "link"))
    assert names(found.prune(both)) == ["curve"]
    strong = search(("curve", 60.0), ("link", 120.0))
    assert names(strong.prune(tuple(g for g in strong.groups if g.name in ("curve", "link")))) == ["curve", "link"]


def test_the_best_curves_are_those_that_gain() -> None:
    assert [g.name for g in search(("curve", 40.0)).best_curves(())] == ["curve"]
    assert search(("one", 40.0)).best_curves(()) == []
