"""What may be said of a selection; intervals that say what laws leave; scores that are carried along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.library import effect_named
from hd_control.lab.diagnosis.candidates import Group
from hd_control.lab.diagnosis.claims import HIGHER, LEAST, refuted, sure
from hd_control.lab.diagnosis.corrections import CorrectedSearch, prepare
from hd_control.lab.diagnosis.fit import Interval, widened
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.verdict import NamedEffect, Unknown
from hd_control.lab.models.answers import joint_task
from hd_sim.puzzles.campaign import nominal_model, recording
from hd_sim.puzzles.recordings import make_pair

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


def test_scores_that_are_carried_along_are_those_of_the_rows() -> None:
    """Scaling, other rows, louder noise, another damping and refined shapes, against Gram matrices made anew."""
    pair = make_pair(5003, "one")
    joint = str(pair.model["joint"])
    task = joint_task(recording(pair.fit, joint, pair.period), nominal_model(pair.model), joint)
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
    assert corrected.leave_blind_rows(tuple(corrected.dictionary.groups[:60]))
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
