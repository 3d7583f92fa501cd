"""Candidates: free curves as splines, what the gauge misreads in three balances, every shape of every effect once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import PLAIN, equations

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.library import effect_named, library
from hd_control.lab.diagnosis.candidates import (
    ORDERS,
    Candidate,
    curve_candidates,
    curves,
    even_knots,
    group_of,
    library_candidates,
    misread,
    quantile_knots,
    splines,
)

ALL = {MOTOR, TRANSMISSION, LINK}
STATES = equations().states


def test_splines_add_up_to_one_everywhere() -> None:
    x, knots = np.linspace(-2.0, 3.0, 500), np.array([-1.0, 0.0, 0.5, 2.0])
    found = splines(x, knots)
    assert found.shape == (500, knots.size + 2)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert (found >= 0.0).all()
    np.testing.assert_array_equal(found[x < -1.0], found[x < -1.0][:1].repeat((x < -1.0).sum(), axis=0))
    assert (found > 0.0).sum(axis=1).max() <= 4, "local: four at a place"


@pytest.mark.parametrize("power", [0, 1, 2, 3])
def test_splines_hold_every_cubic_exactly(power: int) -> None:
    x, knots = np.linspace(-1.0, 2.0, 400), np.array([-1.0, 0.0, 0.5, 2.0])
    basis = splines(x, knots)
    left = x**power - basis @ np.linalg.lstsq(basis, x**power, rcond=None)[0]
    assert np.abs(left).max() < 1e-10


def test_knots_stand_where_the_data_are() -> None:
    x = np.concatenate([np.zeros(900), np.linspace(0.0, 1.0, 101)])
    knots = quantile_knots(x, 11)
    assert (np.diff(knots) > 0.0).all() and (knots[0], knots[-1]) == (0.0, 1.0), "no knot twice"
    assert quantile_knots(np.arange(101.0), 5).tolist() == [0.0, 25.0, 50.0, 75.0, 100.0]
    assert even_knots(np.array([3.0, -1.0, 0.0]), 5).tolist() == [-1.0, 0.0, 1.0, 2.0, 3.0]


def by_name(states, channels=frozenset(ALL)):  # type: ignore[no-untyped-def] # a helper of this file
    return {curve.name: curve for curve in curves(states, set(channels))}


def test_curves_of_a_channel_need_that_channel() -> None:
    whole = by_name(STATES)
    for name, curve in whole.items():
        head = name.split(":")[0]
        channels = set(curve.columns_at(STATES))
        assert channels == ({MOTOR, LINK, TRANSMISSION} if head == "gauge" else {head})
    for channel in ALL:
        alone = by_name(STATES, {channel})
        assert {name.split(":")[0] for name in alone} == {channel}
        assert set(alone) <= set(whole)
    assert not any("gauge" in name for name in by_name(STATES, {MOTOR, TRANSMISSION}))


def test_variables_that_do_not_vary_or_are_not_known_have_no_curve() -> None:
    whole = by_name(STATES)
    assert not any("temperature" in name for name in whole), "it was not recorded"
    warm = replace(STATES, temperature=20.0 + STATES.time / 3.0)
    assert {n.split(":")[0] for n in by_name(warm) if "temperature" in n} == {MOTOR, TRANSMISSION, LINK, "gauge"}
    mild = replace(STATES, temperature=20.0 + STATES.time / 60.0)
    assert not any("temperature" in name for name in by_name(mild)), "half a kelvin"
    still = replace(STATES, joint_position=np.zeros(STATES.time.size))
    assert not any("joint_position" in name for name in by_name(still))
    little = replace(STATES, motor_position=1e-4 * STATES.motor_position)
    assert not any("motor_shaft_position" in name for name in by_name(little)), "less than a turn"
    assert not any("time" in curve.variables for curve in curves(STATES, set(ALL), time_too=False))


def test_a_kind_multiplies_its_curve() -> None:
    found = by_name(STATES)
    for kind, factor in (("with direction", STATES.motor_direction), ("with speed", STATES.motor_velocity)):
        columns = found[f"{MOTOR}: time {kind}"].columns_at(STATES)[MOTOR]
        np.testing.assert_allclose(columns.sum(axis=1), factor, atol=1e-12)
        assert found[f"{MOTOR}: time {kind}"].variables == ("time", kind.removeprefix("with "))
    plain = found[f"{MOTOR}: time plain"].columns_at(STATES)[MOTOR]
    np.testing.assert_allclose(plain.sum(axis=1), 1.0)
    load = found[f"{MOTOR}: motor_shaft_position with torque"].columns_at(STATES)[MOTOR]
    np.testing.assert_allclose(np.hypot(load[:, 0], load[:, len(ORDERS)]), np.abs(STATES.joint_torque), rtol=1e-9)


def test_a_constant_torsion_is_the_assembly_zero_and_no_curve() -> None:
    for name, curve in by_name(STATES).items():
        if name.startswith(TRANSMISSION) and curve.variable != "motor_shaft_position":
            np.testing.assert_allclose(curve.columns_at(STATES)[TRANSMISSION].mean(axis=0), 0.0, atol=1e-12)


def test_waves_of_the_rotor_have_their_orders() -> None:
    columns = by_name(STATES)[f"{MOTOR}: motor_shaft_position plain"].columns_at(STATES)[MOTOR]
    for k, order in enumerate(ORDERS):
        np.testing.assert_allclose(columns[:, k], np.cos(order * STATES.motor_shaft_position), atol=1e-9)
        np.testing.assert_allclose(columns[:, len(ORDERS) + k], np.sin(order * STATES.motor_shaft_position), atol=1e-9)


def test_what_the_gauge_adds_is_minus_on_the_rotor_plus_on_the_link_and_a_torsion_behind_the_damper() -> None:
    """On a joint whose gauge adds a slow wave: what its balances are wrong by is that column, with coefficient 1."""
    added = 0.5 * np.sin(2.0 * np.pi * 0.9 * STATES.time)[:, None]
    # The gauge of the plain joint is its torque, so the wrong torsion is that of the wave alone.
    torsion = misread(STATES, added)[TRANSMISSION][:, 0]
    d, omega = PLAIN.damping_time, 2.0 * np.pi * 0.9
    answer = 0.5 / PLAIN.stiffness * np.imag(np.exp(1j * omega * STATES.time) / (1.0 + 1j * omega * d))
    settled = slice(int(10 * d / STATES.period), None)
    np.testing.assert_allclose((torsion - torsion.mean())[settled], (answer - answer.mean())[settled], atol=2e-8)
    found = misread(STATES, added)
    assert found[LINK] is added and np.array_equal(found[MOTOR], -added)
    rigid = misread(replace(STATES, torsional_compliance=0.0), added)
    assert set(rigid) == {MOTOR, LINK}, "without a spring that is known there is no torsion"


def test_a_bilinear_lag_keeps_constants_and_delays_ramps() -> None:
    """1 / (1 + d s) of a constant is the constant, of a ramp the ramp d later; d = 0 changes nothing."""
    ramp = STATES.time[:, None].copy()
    for d in (5e-3, 0.02):
        late = misread(replace(STATES, damping_time=d, torsional_compliance=1.0), ramp)[TRANSMISSION][:, 0]
        mean = float(np.mean(ramp) - d * (1.0 - 0.02))
        settled = slice(int(20 * d / STATES.period), None)
        np.testing.assert_allclose(late[settled], ramp[settled, 0] - d - mean, atol=0.05 * d)
    constant = misread(replace(STATES, damping_time=0.01, torsional_compliance=1.0), np.ones_like(ramp))
    np.testing.assert_allclose(constant[TRANSMISSION], 0.0, atol=1e-12)


def test_every_shape_of_every_effect_that_acts_here_is_a_candidate() -> None:
    effects = [effect for effect in library().values() if not effect.in_every_model]
    found = list(library_candidates(effects, STATES, ALL))
    names = {candidate.name for candidate in found}
    assert "temperature_friction" not in names, "its columns are no numbers without a temperature"
    for effect in effects:
        if effect.name in names:
            shapes = [c.shape for c in found if c.name == effect.name]
            assert len(shapes) <= len(effect.shapes(STATES)) and all(s in list(effect.shapes(STATES)) for s in shapes)
    link_only = list(library_candidates(effects, STATES, {LINK}))
    assert all(set(candidate.columns) == {LINK} for candidate in link_only)
    assert {"payload", "gauge_gain"} <= {c.name for c in link_only} and "motor_cogging" not in {
        c.name for c in link_only
    }


def test_columns_of_zeros_are_no_candidate() -> None:
    drag = effect_named("quadratic_drag")
    rest = replace(STATES, motor_velocity=np.zeros(STATES.time.size))
    assert list(library_candidates([drag], rest, ALL)) == []
    assert len(list(library_candidates([drag], STATES, ALL))) == 1


def test_a_group_has_its_coefficients_behind_those_before_it() -> None:
    candidate = Candidate("two", {MOTOR: np.zeros((5, 3)), LINK: np.zeros((5, 3))}, shape={"order": 2})
    group = group_of(candidate, 7)
    assert group.index.tolist() == [7, 8, 9] and group.channels == (MOTOR, LINK) and not group.is_curve
    (curve,) = [c for c in curves(STATES, {LINK}) if c.name == f"{LINK}: time plain"]
    (as_candidate,) = curve_candidates([curve], STATES, {LINK})
    assert group_of(as_candidate, 0).is_curve and group_of(as_candidate, 0).index.size == curve.knots.size + 2


def test_the_curve_of_an_effect_that_nobody_knows_fits_it() -> None:
    """Friction over the joint's angle, which no law of the library has: the curve leaves little of it."""

    def bump(phi: float, v: float, tau: float, t: float) -> float:
        return 1.5 * float(np.exp(-(((phi + 0.1) / 0.08) ** 2)))

    there = equations(Changes(rotor=bump))
    curve = by_name(there.states)[f"{MOTOR}: joint_position plain"]
    basis = curve.columns_at(there.states)[MOTOR]
    true = np.array([bump(x, 0.0, 0.0, 0.0) for x in there.states.joint_position.tolist()])
    left = true - basis @ np.linalg.lstsq(basis, true, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.02 * true.std()
