"""A fitted selection: values of the base in every unit, errors in the channel's own, intervals that cover the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import PLAIN, equations, known, link_of, planted, signals
from test_dictionary import CANDIDATES

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context
from hd_control.drive.library import effect_named
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.balances.torsion import with_damping
from hd_control.lab.diagnosis.candidates import Candidate
from hd_control.lab.diagnosis.dictionary import Dictionary, build
from hd_control.lab.diagnosis.fit import Bootstrap, Fit, Interval, RawRows, index_of, interval_of
from hd_control.lab.diagnosis.scores import Scores

DEFAULT = Context(1e4, 1.0, 10.0)


@lru_cache(maxsize=1)
def plain() -> Fit:
    """The plain joint, nothing selected."""
    dictionary = build(equations(), CANDIDATES)
    return Fit.of(dictionary, Scores(dictionary), ())


TRUTH = {
    "rotor_inertia": (PLAIN.rotor_inertia, 2e-3),
    "coulomb_torque": (PLAIN.coulomb, 2e-3),
    "viscous": (PLAIN.viscous, 2e-3),
    "torsional_stiffness": (PLAIN.stiffness, 3e-4),
    "damping_time": (PLAIN.damping_time, 0.05),
    "link_inertia_scale": (1.0, 1e-3),
}
"""Values and relative errors: 30 s of a good recording; the rotor's corners at stops are rounded by the filter."""


@pytest.mark.parametrize("name", sorted(TRUTH))
def test_the_values_of_every_joint_are_found(name: str) -> None:
    value, error = TRUTH[name]
    assert getattr(plain(), name) == pytest.approx(value, rel=error)
    assert plain().transmission_zero == pytest.approx(0.0, abs=1e-7)


def test_damping_around_another_guess_is_the_same_damping() -> None:
    """The torsion is linear around the damping of the channel; from 1.3 times the truth one step comes within 3 %."""
    moved = with_damping(equations(), 1.3 * PLAIN.damping_time)
    found = build(moved, ())
    fit = Fit.of(found, Scores(found), ())
    assert found.equations.channels[TRANSMISSION].damping_time == pytest.approx(1.3 * PLAIN.damping_time)
    assert fit.damping_time == pytest.approx(plain().damping_time, rel=0.03)


def test_other_units_of_the_balances_change_no_value() -> None:
    """After rescaling by the fitted a and b these are one, and every physical value is as it was."""
    wrong = replace(known(), rotor_inertia=1.3 * PLAIN.rotor_inertia)
    found = build(build_equations(signals(), wrong, link_of(signals())), CANDIDATES)
    before = Fit.of(found, Scores(found), found.groups[:1])
    assert before.scale(MOTOR) == pytest.approx(1.3, rel=5e-3)
    rescaled = found.rescaled(before.scales)
    after = Fit.of(rescaled, Scores(rescaled), rescaled.groups[:1])
    assert after.scales == pytest.approx(
        {MOTOR: 1.0, LINK: 1.0}, abs=2e-5
    )  # priors of delays weigh a little differently
    for name, (value, error) in TRUTH.items():
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-5)
        assert getattr(after, name) == pytest.approx(value, rel=2.0 * error)
    # A column of the rotor is a torque: its physical coefficient is that over a.
    a, b = (f.coefficients[f.selection[0].index] / f.scale(MOTOR) for f in (before, after))
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_values_of_an_effect_are_physical_whatever_the_units_are() -> None:
    """An offset of 1.5 N m on the rotor, in balances whose inertia is taken 1.3 times too large: coefficient over a."""
    there = signals(Changes(rotor=_offset))
    effect = effect_named("asymmetric_friction")
    for factor in (1.0, 1.3):
        units = replace(known(), rotor_inertia=factor * PLAIN.rotor_inertia)
        balances = build_equations(there, units, link_of(there))
        found = build(balances, [Candidate(effect.name, effect.columns(balances.states, {"viscous": False}), effect,
                                           {"viscous": False})])  # fmt: skip
        fit = Fit.of(found, Scores(found), found.groups)
        assert fit.parameters(found.groups[0], DEFAULT)["friction_offset"] == pytest.approx(1.5, rel=5e-3)
        assert fit.coefficients[found.groups[0].index[0]] == pytest.approx(factor * 1.5, rel=0.01)


def _offset(phi: float, v: float, tau: float, t: float) -> float:
    return 1.5


def test_where_a_balance_is_missing_its_values_are_no_numbers() -> None:
    bare = replace(signals(), motor_torque=None)
    found = build(build_equations(bare, known(), link_of(bare)), ())
    fit = Fit.of(found, Scores(found), ())
    assert np.isnan(fit.coulomb_torque) and np.isnan(fit.viscous)
    assert fit.torsional_stiffness == pytest.approx(PLAIN.stiffness, rel=1e-3)
    assert set(fit.scales) == {LINK} and fit.scale(MOTOR) == 1.0
    assert fit.context(DEFAULT).coulomb_torque == DEFAULT.coulomb_torque
    blind = replace(signals(), joint_position=None)
    found = build(build_equations(blind, known(), None), ())
    fit = Fit.of(found, Scores(found), ())
    assert np.isnan(fit.torsional_stiffness) and np.isnan(fit.damping_time) and np.isnan(fit.transmission_zero)
    assert fit.context(DEFAULT).torsional_stiffness == DEFAULT.torsional_stiffness


def test_a_spring_that_pulls_the_wrong_way_is_no_stiffness() -> None:
    turned = replace(plain(), coefficients=-plain().coefficients)
    assert np.isnan(turned.torsional_stiffness)
    assert turned.context(DEFAULT).torsional_stiffness == DEFAULT.torsional_stiffness


def test_the_relative_error_is_that_of_least_squares() -> None:
    """1.96 standard errors of white noise, priors and all, from the rows themselves."""
    d = plain().dictionary
    i = d.base_index(TRANSMISSION, "torsional_compliance")
    rows = []
    for part in d.rows.values():
        whole = np.zeros((int((part.fold >= 0).sum()), d.base.size))
        inside = part.index < d.base.size
        whole[:, part.index[inside]] = part.columns[part.fold >= 0][:, inside]
        rows.append(whole)
    gram = sum(x.T @ x for x in rows) + np.diag(d.ridge[d.base] + d.precision[d.base] / d.norm[d.base] ** 2)
    error = 1.96 * np.sqrt(np.linalg.inv(gram)[i, i]) / d.norm[i] / abs(plain().coefficients[i])
    assert plain().relative_error(TRANSMISSION, "torsional_compliance") == pytest.approx(error, rel=1e-6)
    assert plain().relative_error(TRANSMISSION, "nothing") == np.inf


def test_residuals_are_what_the_coefficients_leave() -> None:
    for name, residual in plain().residuals().items():
        part = plain().dictionary.rows[name]
        scaled = plain().coefficients * plain().dictionary.norm
        np.testing.assert_allclose(residual, part.left - part.columns @ scaled[part.index])
        if name != MOTOR:  # there the corners at stops stay
            assert np.mean(residual**2) == pytest.approx(1.0, abs=0.12)


def test_raw_rows_are_the_balance_in_its_own_unit() -> None:
    groups = plain().dictionary.groups
    raw = RawRows(plain().dictionary, ())
    for name, residual in raw.residual(plain().coefficients).items():
        channel = equations().channels[name]
        by_hand = channel.left.copy()
        for base in channel.base:
            by_hand -= base.column * plain().coefficients[plain().dictionary.base_index(name, base.name)]
        np.testing.assert_allclose(residual, by_hand, atol=1e-12 * np.abs(channel.left).max())
    assert index_of(plain().dictionary, groups[:1]).tolist() == [*plain().dictionary.base, *groups[0].index]


def test_held_out_errors_are_those_of_the_folds() -> None:
    """Fold by fold in physical units, the coefficients of a fold from all others; the RMS over all folds."""
    d, scores = plain().dictionary, plain().scores
    raw, index = RawRows(d, ()), d.base
    found = raw.held_out_errors(scores, ())
    for name, channel in equations().channels.items():
        part, square, count = d.rows[name], 0.0, 0
        for fold, scaled in enumerate(scores.train(index)):
            values = dict(zip(d.base_names, scaled / d.norm[index], strict=True))
            residual = channel.left.copy()
            for base in channel.base:
                residual -= base.column * values[("" if base.shared else name, base.name)]
            rows = residual[part.usable][part.fold == fold]
            square, count = square + float(rows @ rows), count + rows.size
        assert found[name] == pytest.approx(np.sqrt(square / count), rel=1e-9)


SLOW = np.sin(2.0 * np.pi * 0.35 * equations().states.time)[:, None]
LAW = Candidate("law", {MOTOR: SLOW})
TRIALS = 80
"""Of a probability of 0.95 that many trials give 0.95 +- 0.025; 22 blocks know their own spread to 15 %."""


@lru_cache(maxsize=2)
def trials(memory: float) -> tuple[list[Fit], float]:
    """Fits of planted rows and the coefficient that was planted."""
    found = []
    for seed in range(TRIALS):
        d = planted([LAW], {"law": 40.0}, seed, memory)
        found.append(Fit.of(d, Scores(d), d.groups))
    d = found[0].dictionary
    return found, 40.0 / float(d.norm[d.groups[0].index[0]])


@pytest.mark.parametrize(("memory", "low"), [(0.0, 0.88), (0.95, 0.85)])
def test_intervals_cover_the_truth_as_often_as_they_say(memory: float, low: float) -> None:
    """95 %, with noise that is white and with one that hangs together over 20 rows."""
    fits, true = trials(memory)
    hits = 0
    for seed, fit in enumerate(fits):
        at = int(fit.selection[0].index[0])
        interval = interval_of(float(fit.coefficients[at]), Bootstrap(fit, seed).coefficients[:, at])
        hits += interval.low < true < interval.high
    assert low <= hits / TRIALS <= 0.99


def test_without_blocks_the_interval_would_be_too_short() -> None:
    """The check above can fail: plain least squares takes correlated rows for independent ones."""
    fits, true = trials(0.95)
    hits = 0
    for fit in fits:
        index, at = fit.index, int(fit.selection[0].index[0])
        gram = fit.scores.gram_all[np.ix_(index, index)] + np.diag(fit.scores.ridge[index])
        deviation = float(np.sqrt(np.linalg.inv(gram)[-1, -1])) / fit.dictionary.norm[at]
        hits += abs(float(fit.coefficients[at]) - true) < 1.96 * deviation
    assert hits / TRIALS < 0.75


def test_draws_of_the_base_are_centred_on_the_fit() -> None:
    """Attributes of a fit, drawn: rotor inertia and friction, with the errors that their trials have."""
    fits, _ = trials(0.0)
    bootstrap = Bootstrap(fits[0])
    for name in ("rotor_inertia", "coulomb_torque", "torsional_stiffness"):
        draws = bootstrap.base(name)
        seen = float(np.std([getattr(fit, name) for fit in fits]))
        assert abs(np.median(draws) - getattr(fits[0], name)) < seen
        assert draws.std() == pytest.approx(seen, rel=0.4)


def test_equal_seeds_draw_equally() -> None:
    fit = trials(0.0)[0][0]
    np.testing.assert_array_equal(Bootstrap(fit, 3).coefficients, Bootstrap(fit, 3).coefficients)
    assert not np.array_equal(Bootstrap(fit, 3).coefficients, Bootstrap(fit, 4).coefficients)


def stribeck(velocity: float) -> Dictionary:
    """A joint with Stribeck friction of 0.1 rad/s, its column at another velocity."""
    sliding = Changes(coulomb=_stribeck)
    effect, shape = effect_named("stribeck_friction"), {"stribeck_velocity": velocity}
    there = equations(sliding)
    return build(there, [Candidate(effect.name, effect.columns(there.states, shape), effect, shape)])


def _stribeck(v: float, tau: float, t: float) -> float:
    return 2.4 * float(np.exp(-((v / 0.1) ** 2)))


def test_shapes_are_drawn_with_the_coefficients() -> None:
    """At the true shape its interval holds the truth and is as wide as the linearised fit says: with the slope of the
    column over the shape as one more column."""
    d = stribeck(0.1)
    fit = Fit.of(d, Scores(d), d.groups)
    bootstrap, (group,) = Bootstrap(fit), d.groups
    found = bootstrap.parameters(group, DEFAULT)
    assert found["stribeck_ratio"].value == pytest.approx(1.6, rel=0.01)
    assert found["stribeck_velocity"].value == 0.1, "the best value is that of the shape"
    assert found["stribeck_velocity"].low < 0.1 < found["stribeck_velocity"].high
    draws = bootstrap.draws_of(group, DEFAULT)["stribeck_velocity"]
    effect, states, h = group.effect, d.equations.states, 1e-4
    assert effect is not None
    near = [effect.columns(states, {"stribeck_velocity": 0.1 + s * h})[MOTOR][:, 0] for s in (-1.0, 1.0)]
    change = (near[1] - near[0]) / (2.0 * h) * fit.coefficients[group.index[0]]
    slope = d.whitened({MOTOR: change[:, None]})[MOTOR]
    part = d.rows[MOTOR]
    x = np.concatenate([part.columns, slope], axis=1)
    linear = float(np.sqrt(np.linalg.pinv(x.T @ x)[-1, -1]))
    # The corners at stops are no white noise: blocks see more than the rows alone say, but not much.
    assert linear < draws.std() < 4.0 * linear


def test_an_interval_is_centred_on_the_value() -> None:
    """The quantiles of the draws about their median, laid around the value; draws that are no numbers do not count."""
    draws = 10.0 + np.linspace(-1.0, 1.0, 201)
    found = interval_of(3.0, draws)
    assert found == Interval(3.0, pytest.approx(3.0 - 0.95), pytest.approx(3.0 + 0.95))
    assert interval_of(3.0, np.full(5, np.nan)) == Interval(3.0, 3.0, 3.0)


def test_a_positive_shape_stays_positive() -> None:
    d = stribeck(0.1)
    fit = Fit.of(d, Scores(d), d.groups)
    bootstrap = Bootstrap(fit)
    bootstrap.shapes = {key: np.full(values.size, -5.0) for key, values in bootstrap.shapes.items()}
    low = bootstrap.draws_of(d.groups[0], DEFAULT)["stribeck_velocity"]
    np.testing.assert_allclose(low, 0.1 / 3.0)
