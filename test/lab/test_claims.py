"""What may be said of a selection; intervals that say what laws leave; scores that are carried along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, PLAIN, model, planted, recording, signals
from scipy.signal import lfilter
from test_search import CANDIDATES, names, search

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.library import effect_named
from hd_control.drive.model import ModelValue
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.claims import (
    HIGHER,
    LARGEST_GAIN,
    LEAST,
    SMALLEST_SHARE,
    beside,
    bursts,
    confidence,
    features,
    refuted,
    sure,
    unknown_in,
    whiteness,
)
from hd_control.lab.diagnosis.corrections import CorrectedSearch, prepare
from hd_control.lab.diagnosis.fit import Fit, Interval, RawRows, widened
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.verdict import NamedEffect, Unknown
from hd_control.lab.models.answers import joint_task

DELAY = NamedEffect("actuation_delay", "", 1.0, MOTOR, 300.0, 5.0, 1.0, 0.9, {}, {}, "")
GROUP = Group("actuation_delay", np.array([0]), (MOTOR,), effect_named("actuation_delay"))


def claim(low: float, high: float) -> NamedEffect:
    return replace(DELAY, parameters={"delay": Interval(0.5 * (low + high), low, high)})


@pytest.mark.parametrize(
    ("low", "high", "after", "words"),
    [
        (1e-3, 2e-3, 0.9, None),
        (-1e-3, 1e-3, 0.9, None),  # zero is possible
        (-2e-3, -1e-3, 0.9, "impossible delay -0.0015 s"),
        (0.2, 0.3, 0.9, "impossible delay"),
        (1e-3, 2e-3, 1.001 * HIGHER, "error of the motor torque larger"),
    ],
)
def test_a_name_stands_or_says_why_not(low: float, high: float, after: float, words: str | None) -> None:
    found = refuted(claim(low, high), GROUP, {MOTOR: 1.0}, {MOTOR: after})
    assert (found is None) if words is None else (found is not None and words in found)


def test_strong_neighbours_and_the_unknown_count_on_the_same_channels_only() -> None:
    alone, beside = replace(DELAY, beside=0.0), replace(DELAY, beside=1e7)
    channels = {"actuation_delay": (MOTOR,)}
    (said,) = sure((alone,), None, channels)
    assert said.confidence > LEAST and sure((beside,), None, channels) == ()
    elsewhere, here = (Unknown(name, ("time",), "") for name in (TRANSMISSION, MOTOR))
    (same,) = sure((alone,), elsewhere, channels)
    assert same.confidence == said.confidence and sure((alone,), here, channels) == ()


def test_intervals_say_what_laws_leave() -> None:
    wave = {"cosine_2": Interval(3.0, 2.9, 3.1), "sine_2": Interval(4.0, 4.0, 4.0)}
    gear, motor = effect_named("kinematic_error"), effect_named("motor_cogging")
    found = widened(gear, wave)
    error = 5.0 * gear.law_error
    assert found["cosine_2"].high == pytest.approx(3.0 + np.hypot(0.1, error))
    assert found["sine_2"].low == pytest.approx(4.0 - error)
    cogging = widened(motor, {n: Interval(10.0, 10.0, 10.0) for n in ("cogging_order", "cogging_phase")})
    assert cogging["cogging_order"] == Interval(10.0, 10.0, 10.0)
    assert cogging["cogging_phase"].high == pytest.approx(10.0 + motor.law_error)


def _stribeck(v: float, tau: float, t: float) -> float:
    return 2.4 * float(np.exp(-((v / 0.1) ** 2)))


def test_scores_that_are_carried_along_are_those_of_the_rows() -> None:
    """Scaling, other rows, louder noise, another damping and refined shapes, against Gram matrices made anew."""
    wrong = model().with_effect(NAME, "rotor_inertia", {"rotor_inertia": ModelValue(1.1 * PLAIN.rotor_inertia)})
    task = joint_task(recording(signals(Changes(coulomb=_stribeck))), wrong, NAME)
    corrected = CorrectedSearch(task, prepare(task))

    def same() -> None:
        fresh = Scores(corrected.dictionary)
        assert np.abs(fresh.gram - corrected.scores.gram).max() < 1e-12  # columns of unit norm
        np.testing.assert_allclose(corrected.scores.right, fresh.right, rtol=0, atol=1e-12 * np.abs(fresh.right).max())
        np.testing.assert_allclose(corrected.scores.squares, fresh.squares, rtol=1e-12)
        index = corrected.search.index(())
        assert sum(fresh.channel_losses(index).values()) == pytest.approx(fresh.loss(index) - prior(fresh, index))

    corrected.rescale(())
    same()
    selection, moved = corrected.correct(corrected.search.forward(()))
    assert moved
    same()
    assert corrected.leave_blind_rows(tuple(corrected.dictionary.groups))
    same()
    assert corrected.mend_noise(()) and set(corrected.dictionary.rows) == {MOTOR, TRANSMISSION, LINK}
    same()
    assert selection


def prior(scores: Scores, index: np.ndarray) -> float:
    """What the priors of the base add to the loss, nats."""
    c = scores.train(index)
    return 0.5 * float(np.sum(c**2 @ scores._prior[index])) / len(c)


def test_blocks_that_no_other_block_can_predict_are_no_noise() -> None:
    from hd_control.lab.diagnosis.dictionary import _without_outliers

    seen, unseen = np.ones(60), np.full(60, 1.2)
    unseen[20:30] = 9.0
    block = np.repeat(np.arange(6), 10)
    found = _without_outliers(seen, unseen, block, np.ones(60, dtype=bool))
    np.testing.assert_allclose(found, 1.2)


def test_confidence_is_the_logistic_of_its_features() -> None:
    """1 / (1 + exp(-w x)), w x = -2.5 + 1.8 log10 gain + 1.1 log10 share - 3.3 unknown."""
    assert features(1000.0, 1e4, True) == (1.0, 3.0, -1.0, 1.0)
    score = -2.5 + 1.8 * 3.0 - 1.1 - 3.3
    assert confidence(1000.0, 1e4, True) == pytest.approx(1.0 / (1.0 + np.exp(-score)))
    assert features(5.0, 0.0, False) == (1.0, pytest.approx(np.log10(5.0)), 0.0, 0.0), "no other effect at all"
    assert features(100.0, 10.0, False)[2] == 0.0, "the strongest itself"


def test_confidence_grows_with_the_gain_and_falls_beside_stronger_ones() -> None:
    gains = [confidence(gain, 1e4, False) for gain in (1.0, 40.0, 200.0, 1e3, LARGEST_GAIN)]
    assert gains == sorted(gains) and len(set(gains)) == len(gains)
    assert confidence(10.0 * LARGEST_GAIN, 1e12, False) >= confidence(LARGEST_GAIN, 1e12, False)
    shares = [confidence(200.0, strongest, False) for strongest in (200.0, 1e3, 1e5)]
    assert shares == sorted(shares, reverse=True)
    assert confidence(200.0, 200.0 / SMALLEST_SHARE, False) == confidence(200.0, 1e12, False), "no less than that"
    assert all(confidence(g, 1e4, True) < confidence(g, 1e4, False) for g in (40.0, 1e3))
    assert all(0.0 < value < 1.0 for value in (*gains, *shares))


def test_white_rows_are_white_and_others_are_not(rng: np.random.Generator) -> None:
    """The largest of 40 correlations of white rows is below 4 standard errors; r = 0.3 is 0.3 sqrt(n) at lag 1."""
    white = rng.standard_normal(4000)
    found = whiteness({"a": white, "b": lfilter([1.0], [1.0, -0.3], white), "c": 2.0 * white, "few": white[:199]})
    assert set(found) == {"a", "b", "c"}, "two hundred rows at least"
    assert found["a"].mean_square == pytest.approx(1.0, abs=0.1) and found["a"].correlation < 4.0
    assert found["b"].correlation == pytest.approx(0.3 * np.sqrt(4000.0), rel=0.2)
    assert found["c"].mean_square == pytest.approx(4.0 * found["a"].mean_square)


def burst_fit(*times: float) -> Fit:
    """White rows, ten times as loud for 0.3 s at each of the times on the link."""
    dictionary = planted(CANDIDATES)
    part = dictionary.rows[LINK]
    for time in times:
        part.left[(part.time > time) & (part.time < time + 0.3)] *= 10.0
    return Fit.of(dictionary, Scores(dictionary), ())


def test_bursts_are_found_at_their_times() -> None:
    """Blocks of 0.33 s: the mean time of the block in which a burst lies, or of the two that share it."""
    quiet = {b.channel: b for b in bursts(burst_fit())}
    assert set(quiet) == {MOTOR, TRANSMISSION, LINK} and not any(b.found for b in quiet.values())
    assert all(b.worst < 6.0 for b in quiet.values())
    loud = {b.channel: b for b in bursts(burst_fit(7.0, 18.0))}
    assert loud[LINK].found and not loud[MOTOR].found
    near = [min(abs(t - 7.15), abs(t - 18.15)) for t in loud[LINK].times]
    assert max(near) < 0.33
    assert len(bursts(burst_fit(7.0))[2].times) >= 1


def test_a_strong_neighbour_counts_on_the_channels_that_both_have() -> None:
    """On each of them by the loss without it, less the loss with everything."""
    found = search(("one", 60.0), ("link", 30.0))
    selection = tuple(group for group in found.groups if group.name in ("one", "link", "burst"))
    gains = beside(found, selection)
    index = found.index(selection)
    one = next(group for group in selection if group.name == "one")
    whole, without = (found.scores.channel_losses(i) for i in (index, np.setdiff1d(index, one.index)))
    assert gains["burst"] == pytest.approx(without[MOTOR] - whole[MOTOR]), "the burst stands beside it on the rotor"
    assert gains["link"] == 0.0, "no other law is on the link"
    assert gains["one"] == pytest.approx(max(0.0, _gain(found, selection, "burst")), abs=1e-6)


def _gain(found, selection, name):  # type: ignore[no-untyped-def] # a helper of this file
    index = found.index(selection)
    group = next(group for group in selection if group.name == name)
    without = found.scores.channel_losses(np.setdiff1d(index, group.index))
    return without[MOTOR] - found.scores.channel_losses(index)[MOTOR]


def test_a_curve_that_stays_is_the_unknown_unless_its_channel_is_blocked() -> None:
    found = search(("curve", 40.0))
    selection = found.run()
    assert names(selection) == ["curve"]
    fit, raw = found_fit(found, selection)
    left = unknown_in(fit, raw, found, selection, set())
    assert left is not None and (left.channel, left.variables) == (LINK, ("time",))
    assert left.evidence.startswith("link torque: the residual depends on time (")
    assert unknown_in(fit, raw, found, selection, {LINK}) is None
    assert unknown_in(*found_fit(search(), ()), search(), (), set()) is None


def found_fit(found, selection):  # type: ignore[no-untyped-def] # a helper of this file
    return Fit.of(found.dictionary, found.scores, selection), RawRows(found.dictionary, selection)


def test_bursts_are_the_unknown_where_no_curve_is() -> None:
    fit = burst_fit(7.0, 18.0)
    there = search()
    left = unknown_in(fit, RawRows(fit.dictionary, ()), there, (), set())
    assert left is not None and (left.channel, left.variables) == (LINK, ("time",))
    assert "bursts at" in left.evidence and "standard deviations" in left.evidence
    assert unknown_in(fit, RawRows(fit.dictionary, ()), there, (), {LINK}) is None
