"""What decides: responses of candidates, noise that hides nothing, scores without products that nobody asks for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, model, recording, signals

from hd_control.drive.effect import CHANNELS, LINK, MOTOR
from hd_control.drive.library import library
from hd_control.lab.diagnosis.by_innovations import LIMITS
from hd_control.lab.diagnosis.candidates import library_candidates
from hd_control.lab.diagnosis.decide import Question, _beside, _Responses, decide
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.scores import LazyScores, Scores
from hd_control.lab.innovations.equations import Innovations, innovations
from hd_control.lab.models.answers import joint_task

SOME = ("payload", "stribeck_friction", "gauge_offset", "kinematic_error")


@lru_cache(maxsize=4)
def found(changes: Changes = Changes()) -> Innovations:  # noqa: B008
    task = joint_task(recording(signals(changes)), model(), NAME)
    assert task.given is not None
    return innovations(task.given(), task.equations)


def question(changes: Changes = Changes(), names: tuple[str, ...] = SOME) -> Question:  # noqa: B008
    every = library()
    return Question(found(changes), {name: every[name] for name in names}, thresholds=LIMITS)


def _load(q: float, w: float) -> float:
    return 3.0 * float(np.cos(q)) + 5.0 * float(np.sin(q))


LOADED = Changes(link=_load)


def test_lazy_scores_are_the_scores() -> None:
    equations, every = found(), library()
    effects = [every[name] for name in SOME]
    candidates = list(library_candidates(effects, equations.states, CHANNELS))
    dictionary = build(equations, candidates)
    eager, lazy = Scores(dictionary), LazyScores(dictionary)
    base, first = dictionary.base, dictionary.groups[0]
    index = np.concatenate([base, first.index])
    assert lazy.loss(index) == pytest.approx(eager.loss(index))
    assert np.allclose(lazy.train(index), eager.train(index), rtol=1e-6, atol=1e-9)
    assert np.allclose(lazy.gains(index, dictionary.groups[1:]), eager.gains(index, dictionary.groups[1:]), rtol=1e-5)
    assert np.allclose(lazy.block_losses(index), eager.block_losses(index))
    assert lazy.channel_losses(index) == pytest.approx(eager.channel_losses(index))
    more = dictionary.with_candidates(candidates[:2])
    grown = lazy.extended(more)
    behind = np.concatenate([base, more.groups[-1].index])
    assert grown.loss(behind) == pytest.approx(Scores(more).loss(behind))


def test_a_payload_is_decided_and_its_coefficients_are_right() -> None:
    decision = decide(question(LOADED))
    (group,) = decision.selection
    assert group.name == "payload"
    values = decision.fit.parameters(group, question().context)
    assert sorted(abs(v) for v in values.values() if abs(v) > 0.1) == pytest.approx([3.0, 5.0], rel=0.02)


def test_nothing_is_decided_on_a_joint_that_the_model_describes() -> None:
    assert decide(question()).selection == ()


def test_noise_is_white_at_first_and_an_autoregression_later() -> None:
    responses = _Responses(question(), found())
    first, later = responses.noises([], white=True), responses.noises([], white=False)
    assert all(not noise.lags.any() for noise in first.values())
    assert all(noise.lags.any() for noise in later.values())
    for noise in (*first.values(), *later.values()):
        assert noise.scale > 0.0


def test_the_rich_fit_holds_what_is_missing_so_that_noise_does_not() -> None:
    """The noise of a loaded joint is that of the plain one: the load is in the rich fit."""
    plain, loaded = (_Responses(question(c), found(c)).noises([], white=True) for c in (Changes(), LOADED))
    for name, noise in loaded.items():
        assert noise.scale == pytest.approx(plain[name].scale, rel=0.2)


def test_balances_that_are_closed_are_not_named() -> None:
    closed = Question(found(LOADED), question().library, open=frozenset({MOTOR}))
    names = {c.name for c in _Responses(closed, found(LOADED)).free}
    assert "payload" not in names and "stribeck_friction" in names


def test_beside_the_selection_the_load_is_in_the_states() -> None:
    decision = decide(question(LOADED))
    equations = decision.search.dictionary.equations
    assert isinstance(equations, Innovations)
    again = _beside(equations, decision.fit)
    assert set(again.channels) == set(found(LOADED).channels)
    assert again.link_scale == pytest.approx(1.0, rel=0.01)
    assert LINK in decision.selection[0].channels
