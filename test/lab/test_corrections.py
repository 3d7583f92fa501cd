"""What a search assumes and how it is corrected: shapes, noise, rows, scales, damping, effects that stand for others.

Each correction alone, on a case made for it; all of them together are in test_diagnose.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, PLAIN, equations, joint_model, known, link_of, model, planted, recording, signals
from test_dictionary import columns

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context, DriveStates
from hd_control.drive.library import effect_named, library
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.balances.torsion import with_damping
from hd_control.lab.diagnosis.candidates import Candidate, Curve
from hd_control.lab.diagnosis.corrections import (
    CorrectedSearch,
    Task,
    _Projected,
    blind_rows,
    known_candidates,
    merged,
    prepare,
    refine,
    without_cancelling,
)
from hd_control.lab.diagnosis.dictionary import Dictionary, build
from hd_control.lab.diagnosis.fit import Fit
from hd_control.lab.diagnosis.scores import Scores
from hd_control.lab.diagnosis.search import Search
from hd_control.lab.models.answers import joint_task

CONTEXT = Context(PLAIN.stiffness, PLAIN.coulomb, 20.0)


def of(name: str, states: DriveStates, **shape: object) -> Candidate:
    """An effect of the library at one shape."""
    effect = effect_named(name)
    return Candidate(name, effect.columns(states, shape), effect, shape)


def _stribeck(v: float, tau: float, t: float) -> float:
    return 2.4 * float(np.exp(-((v / 0.1) ** 2)))


@lru_cache(maxsize=8)
def stribeck(velocity: float) -> Dictionary:
    """A joint with Stribeck friction of 0.1 rad/s; its column at one velocity, noise of the true one."""
    there = equations(Changes(coulomb=_stribeck))
    noises = None if velocity == 0.1 else stribeck(0.1).noises
    return build(there, [of("stribeck_friction", there.states, stribeck_velocity=velocity)], noises=noises)


@pytest.mark.parametrize("start", [0.055, 0.075, 0.135, 0.18])
def test_a_shape_off_the_grid_is_refined_to_the_true_one(start: float) -> None:
    """Variable projection within 1 %: xatol is 1e-3 of the logarithm, the rest is what stops leave."""
    d = stribeck(start)
    found = refine(d, Scores(d), d.groups)
    assert found["stribeck_friction"].shape["stribeck_velocity"] == pytest.approx(0.1, rel=0.01)
    better = d.with_candidates(list(found.values()))
    gain = [Scores(better).loss(np.concatenate([d.base, group.index])) for group in better.groups]
    assert gain[1] < gain[0] - 100.0


def test_a_shape_that_is_right_stays() -> None:
    d = stribeck(0.1)
    found = refine(d, Scores(d), d.groups)
    assert all(c.shape["stribeck_velocity"] == pytest.approx(0.1, rel=3e-3) for c in found.values())
    best = next(iter(found.values()), None)
    again = d if best is None else stribeck(float(best.shape["stribeck_velocity"]))
    assert refine(again, Scores(again), again.groups) == {}, "0.1 nat more is no better shape"
    only_choices = build(equations(), [Candidate("x", {MOTOR: columns(41)})])
    assert refine(only_choices, Scores(only_choices), only_choices.groups) == {}, "nothing continuous in it"


def test_a_shape_stays_within_its_bounds() -> None:
    """A plain joint has no Stribeck friction, so that any velocity is as good; the bounds are 0.018 and 0.4 rad/s."""
    d = build(equations(), [of("stribeck_friction", equations().states, stribeck_velocity=0.39)])
    for candidate in refine(d, Scores(d), d.groups).values():
        assert 0.018 <= candidate.shape["stribeck_velocity"] <= 0.4


def test_the_projected_loss_is_that_of_the_whole_least_squares() -> None:
    """min over all coefficients of |y - X c - Z d|^2 / 2, less the same without Z, and its d."""
    d = planted([Candidate("held", {MOTOR: columns(42)}), Candidate("moved", {MOTOR: columns(43), LINK: columns(44)})])
    held, moved = d.groups
    raw = {MOTOR: columns(43), LINK: columns(44)}
    change, coefficients = _Projected(d, Scores(d), (held,)).loss(raw)
    squares, solutions = [], []
    for index in (np.concatenate([d.base, held.index]), np.concatenate([d.base, held.index, moved.index])):
        rows, left = [], []
        for part in d.rows.values():
            whole = np.zeros((int((part.fold >= 0).sum()), d.size))
            whole[:, part.index] = part.columns[part.fold >= 0]
            rows.append(whole[:, index])
            left.append(part.left[part.fold >= 0])
        extra = np.diag(np.sqrt(d.ridge[index] + d.precision[index] / d.norm[index] ** 2))
        x = np.concatenate([*rows, extra])
        y = np.concatenate([*left, np.zeros(index.size)])
        solution = np.linalg.lstsq(x, y, rcond=None)[0]
        squares.append(0.5 * float(np.sum((y - x @ solution) ** 2)))
        solutions.append(solution[-moved.index.size :])
    assert change == pytest.approx(squares[1] - squares[0], rel=1e-5)
    np.testing.assert_allclose(coefficients, solutions[1] / d.norm[moved.index], rtol=1e-4)


def test_noise_that_was_taken_too_small_becomes_as_large_as_what_is_left() -> None:
    task = Task(equations(), library(), context=CONTEXT)
    honest = build(equations(), [Candidate("x", {MOTOR: columns(41)})])
    small = {n: noise.divided(1.6 if n == LINK else 1.0) for n, noise in honest.noises.items()}
    many = [Candidate(f"x{k}", {LINK: columns(50 + k, 8)}) for k in range(80)]
    corrected = CorrectedSearch(task, build(equations(), many, noises=small))
    corrected.rescale(())
    assert corrected.mend_noise(())
    left = corrected.fit(()).residuals()[LINK]
    assert 1.4826 * np.median(np.abs(left)) == pytest.approx(1.0, abs=0.06)
    assert not corrected.mend_noise(()), "once is enough"


def test_what_few_columns_cannot_hide_is_no_noise() -> None:
    """sqrt(1 + 10 columns / rows) at most: of a dozen columns on two thousand rows that is 3 %."""
    task = Task(equations(), library(), context=CONTEXT)
    honest = build(equations(), ())
    small = {n: noise.divided(1.6) for n, noise in honest.noises.items()}
    corrected = CorrectedSearch(task, build(equations(), (), noises=small))
    corrected.mend_noise(())
    for name, part in corrected.dictionary.rows.items():
        most = np.sqrt(1.0 + 10.0 * part.columns.shape[1] / part.left.size)
        assert part.noise.scale <= small[name].scale * most * (1.0 + 1e-9)


def test_rows_that_a_law_leaves_out_are_those_it_says_blurred_by_the_filter() -> None:
    """Link friction near standstill of the link; both effects that leave rows out add up."""
    states = equations().states
    friction = of("link_friction", states, terms=("link_coulomb",))
    gap = of("backlash", states, crossing_torque=0.02 * states.torque_scale)
    d = build(equations(), [friction, gap, of("payload", states, terms=("gravity_sine",))])
    found = blind_rows(d, d.groups)
    assert set(found) == {LINK, TRANSMISSION}
    for group, name in ((d.groups[0], LINK), (d.groups[1], TRANSMISSION)):
        assert group.effect is not None
        by_law = group.effect.blind(states, group.shape)[name]
        np.testing.assert_array_equal(found[name], d.rows[name].channel.blurred(by_law))
    assert blind_rows(d, d.groups[2:]) == {}
    narrow = of("backlash", states, crossing_torque=0.005 * states.torque_scale)
    for both in ([narrow, gap], [gap, narrow]):
        two = build(equations(), both)
        np.testing.assert_array_equal(blind_rows(two, two.groups)[TRANSMISSION], found[TRANSMISSION])
    corrected = CorrectedSearch(Task(equations(), library(), context=CONTEXT), d)
    assert corrected.leave_blind_rows(d.groups[:1]) and not corrected.leave_blind_rows(d.groups[2:])
    assert not (corrected.dictionary.rows[LINK].usable & found[LINK]).any()
    np.testing.assert_array_equal(corrected.dictionary.rows[TRANSMISSION].usable, d.rows[TRANSMISSION].usable)


def test_units_become_those_in_which_the_scales_are_one() -> None:
    wrong = replace(known(), rotor_inertia=1.4 * PLAIN.rotor_inertia)
    balances = build_equations(signals(), wrong, link_of(signals()))
    corrected = CorrectedSearch(Task(balances, library(), context=CONTEXT), build(balances, ()))
    before = corrected.fit(()).rotor_inertia
    corrected.rescale(())
    assert corrected.fit(()).scales == pytest.approx({MOTOR: 1.0, LINK: 1.0}, abs=1e-3)
    assert corrected.fit(()).rotor_inertia == pytest.approx(before, rel=1e-4)
    there = corrected.dictionary
    corrected.rescale(())
    assert corrected.dictionary is there, "near one nothing is done"


def test_an_absurd_scale_is_not_followed() -> None:
    """A rotor balance that a fit would explain with a tenth of the inertia keeps its units."""
    wrong = replace(known(), rotor_inertia=10.0 * PLAIN.rotor_inertia)
    balances = build_equations(signals(), wrong, link_of(signals()))
    corrected = CorrectedSearch(Task(balances, library(), context=CONTEXT), build(balances, ()))
    assert corrected.fit(()).scale(MOTOR) == pytest.approx(10.0, rel=0.01)
    corrected.rescale(())
    assert corrected.dictionary.equations.inertia == wrong.rotor_inertia


def test_the_damping_of_the_torsion_follows_the_fit() -> None:
    moved = with_damping(equations(), 2.0 * PLAIN.damping_time)
    corrected = CorrectedSearch(Task(moved, library(), context=CONTEXT), build(moved, ()))
    for _ in range(3):
        corrected.correct(())
    found = corrected.dictionary.equations.channels[TRANSMISSION].damping_time
    assert found == pytest.approx(PLAIN.damping_time, rel=0.05)
    assert abs(corrected.fit(()).damping_time - found) < 3e-5, "no further change"


GAUGE = Changes(gauge=lambda tau, phi, q: 1.05 * tau)


def test_one_effect_on_two_balances_takes_the_place_of_one_on_each() -> None:
    """A gain error of the gauge looks like a wrong torque constant on the rotor and like a payload on the link."""
    there = equations(GAUGE)
    names = (("torque_constant_error", {}), ("payload", {"terms": ("gravity_sine",)}), ("gauge_gain", {}))
    d = build(there, [of(name, there.states, **shape) for name, shape in names])
    search = Search(d, Scores(d))
    constant, payload, gain = d.groups
    better, scales = merged(search, (constant, payload))
    assert [group.name for group in better] == ["gauge_gain"]
    assert set(scales) == {MOTOR, LINK} and all(0.8 < value < 1.2 for value in scales.values())
    # From the units of the wrong pair into those in which the right one has the scales one.
    pair = Fit.of(d, search.scores, (constant, payload)).scales
    moved = d.rescaled(pair)
    better, scales = merged(Search(moved, Scores(moved)), moved.groups[:2])
    assert [group.name for group in better] == ["gauge_gain"]
    last = moved.rescaled(scales)
    assert Fit.of(last, Scores(last), last.groups[2:]).scales == pytest.approx({MOTOR: 1.0, LINK: 1.0}, abs=1e-4)
    assert merged(search, (gain,)) == ((gain,), {}), "what is right stays"
    assert merged(search, ()) == ((), {})


def test_two_effects_that_are_there_stay_two() -> None:
    """A payload and a wrong torque constant, no gain error: the single effect would be worse."""
    both = Changes(motor=lambda u: 1.06 * u, link=lambda q, w: 5.0 * float(np.sin(q)))
    there = equations(both)
    names = (("torque_constant_error", {}), ("payload", {"terms": ("gravity_sine",)}), ("gauge_gain", {}))
    d = build(there, [of(name, there.states, **shape) for name, shape in names])
    selection = d.groups[:2]
    assert merged(Search(d, Scores(d)), selection)[0] == selection


def test_effects_that_cancel_on_one_balance_are_a_curve_on_the_other() -> None:
    """+c and -c on the rotor leave c on the link, which is what was planted there."""
    wave, other = columns(61, 1), columns(62, 1)
    curve = Curve("curve", ("time",), lambda s: {LINK: wave}, np.zeros(1), "time")
    candidates = (
        Candidate("wide", {MOTOR: -other, LINK: wave}),
        Candidate("narrow", {MOTOR: other}),
        Candidate("curve", {LINK: wave}, curve=curve),
    )
    d = planted(candidates, {"curve": 60.0})
    search, groups = Search(d, Scores(d)), d.groups
    assert [g.name for g in without_cancelling(search, groups[:2])] == ["curve"]
    assert without_cancelling(search, groups[1:2]) == groups[1:2], "one alone cancels nothing"
    both = planted(candidates, {"wide": 60.0})
    kept = without_cancelling(Search(both, Scores(both)), both.groups[:1])
    assert [g.name for g in kept] == ["wide"]


def test_what_could_be_missing_is_the_library_without_what_is_held_and_near_reversals() -> None:
    held = model().with_effect(NAME, "payload", dict(joint_model().effects["link_dynamics"]))
    plain = joint_task(recording(signals()), model(), NAME)
    names = {group.name for group in prepare(plain).groups if not group.is_curve}
    assert {"payload", "kinematic_error", "gauge_gain"} < names
    assert not names & {"presliding", "coulomb_friction", "rotor_inertia", "temperature_friction"}
    payload = (effect_named("payload"), {"terms": ("gravity_sine",)})
    knowing = replace(plain, known=(payload,))
    found = prepare(knowing)
    assert [group.name for group in found.known] == ["payload"]
    assert "payload" not in {group.name for group in found.groups}
    (candidate,) = known_candidates(knowing)
    assert set(candidate.columns) == {LINK} and held.joint(NAME).effects["payload"]
    assert Fit.of(found, Scores(found), ()).index.size == len(found.base_names) + 1
