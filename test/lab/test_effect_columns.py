"""Each effect of the library against a joint that has it: its column at the true shape brings back the true size.

The joint of `oracles.simple_joint` is integrated with the effect as its equation on the sheet says, in plain numbers.
The balances of its signals, with the column of the effect beside their own, must give the value that was put in, and
close again: the error comes down to what the plain joint leaves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from oracles.simple_joint import GENERAL, Changes, simulate, with_noise
from plain_joint import PLAIN, known, link_of

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, Context
from hd_control.drive.library import effect_named, library
from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.candidates import Candidate
from hd_control.lab.diagnosis.corrections import blind_rows
from hd_control.lab.diagnosis.dictionary import build
from hd_control.lab.diagnosis.fit import Fit, RawRows
from hd_control.lab.diagnosis.scores import Scores

WIDE = tuple((3.0 * a, f) for a, f in GENERAL)
"""The same motion over three times the angle."""


@dataclass(frozen=True)
class Case:
    """A joint with one effect: what is changed, the values that a model file would give, the channel that shows it
    best, relative error of the values, and what the error without the column is over that with it, at least."""

    changes: Changes
    values: Mapping[str, float]
    channel: str
    error: float
    gain: float
    tones: tuple[tuple[float, float], ...] = GENERAL


def wave(size: float, order: int, phase: float = 0.0):  # type: ignore[no-untyped-def] # a helper of this file
    """(size cos(order x + phase), its slope)."""
    return lambda x: (size * math.cos(order * x + phase), -order * size * math.sin(order * x + phase))


def gap(delta: float) -> float:
    """A spring with 4e-5 rad of play on each side."""
    return PLAIN.stiffness * math.copysign(max(0.0, abs(delta) - 4e-5), delta)


CASES = {
    "actuation_delay": Case(Changes(late=3), {"delay": 3e-3}, MOTOR, 0.03, 1.05),
    "asymmetric_friction": Case(
        Changes(rotor=lambda phi, v, tau, t: 1.5 + 2.0 * abs(v)),
        {"friction_offset": 1.5, "viscous_asymmetry": 2.0},
        MOTOR,
        0.02,
        10.0,
    ),
    "backlash": Case(Changes(spring=gap), {"half_gap": 4e-5, "crossing_torque": 0.15}, TRANSMISSION, 0.02, 3.0),
    "gauge_gain": Case(Changes(gauge=lambda tau, phi, q: 1.05 * tau), {"gauge_gain_error": 0.05}, LINK, 0.02, 10.0),
    "gauge_offset": Case(Changes(gauge=lambda tau, phi, q: tau + 0.8), {"gauge_offset": 0.8}, LINK, 0.02, 10.0),
    "gauge_ripple": Case(
        Changes(gauge=lambda tau, phi, q: tau + wave(0.5, 2, 0.7)(100.0 * phi)[0]),
        {"cosine_2": 0.5 * math.cos(0.7), "sine_2": -0.5 * math.sin(0.7), "joint_turn": 0.0},
        LINK,
        0.02,
        3.0,
    ),
    # A larger one is also seen in the gravity of the angle that is misread, which no column of the link describes.
    "joint_sensor_eccentricity": Case(
        Changes(joint_sensor=lambda q: q + wave(2e-5, 2, 0.5)(q)[0]),
        {"cosine_2": 2e-5 * math.cos(0.5), "sine_2": -2e-5 * math.sin(0.5)},
        TRANSMISSION,
        0.02,
        5.0,
        WIDE,
    ),
    "kinematic_error": Case(
        Changes(kinematic=wave(3e-5, 2, 0.4)),
        {"cosine_2": 3e-5 * math.cos(0.4), "sine_2": -3e-5 * math.sin(0.4)},
        TRANSMISSION,
        0.02,
        5.0,
    ),
    "link_friction": Case(
        Changes(link=lambda q, w: 0.8 * math.tanh(w / 2e-3) + 1.2 * w),
        {"link_coulomb": 0.8, "link_viscous": 1.2},
        LINK,
        0.03,
        5.0,
    ),
    "load_dependent_friction": Case(
        Changes(coulomb=lambda v, tau, t: 4.0 * 0.03 * abs(tau)), {"load_friction_linear": 0.03}, MOTOR, 0.02, 5.0
    ),
    "motor_cogging": Case(
        Changes(rotor=lambda phi, v, tau, t: -1.2 * math.sin(6.0 * 100.0 * phi + 0.7)),
        {"cogging_order": 6.0, "cogging_amplitude": 1.2, "cogging_phase": 0.7},
        MOTOR,
        0.02,
        3.0,
    ),
    "nonlinear_stiffness": Case(
        Changes(spring=lambda d: PLAIN.stiffness * d + 1.5e10 * d**3),
        {"stiffness_cubic": 1.5e10},
        TRANSMISSION,
        0.03,
        5.0,
    ),
    "payload": Case(
        Changes(link=lambda q, w: 3.0 * math.cos(q) + 5.0 * math.sin(q)),
        {"gravity_cosine": 3.0, "gravity_sine": 5.0},
        LINK,
        0.02,
        20.0,
    ),
    "quadratic_drag": Case(
        Changes(rotor=lambda phi, v, tau, t: 6.0 * v * abs(v)), {"quadratic_drag": 6.0}, MOTOR, 0.03, 5.0
    ),
    "stribeck_friction": Case(
        Changes(coulomb=lambda v, tau, t: 4.0 * 0.6 * math.exp(-((v / 0.1) ** 2))),
        {"stribeck_ratio": 1.6, "stribeck_velocity": 0.1},
        MOTOR,
        0.02,
        5.0,
    ),
    "structural_resonance": Case(
        Changes(hanging=(0.15, 2.0 * math.pi * 14.0, 0.05)),
        {"frequency": 14.0, "damping_ratio": 0.05, "inertia_share": 0.15},
        LINK,
        0.03,
        5.0,
    ),
    "temperature_friction": Case(
        Changes(
            temperature=lambda t: 25.0 + t / 3.0,
            rotor=lambda phi, v, tau, t: -0.15 * (t / 3.0 - 5.0) * v,
            coulomb=lambda v, tau, t: -0.08 * (t / 3.0 - 5.0),
        ),
        {"viscous_slope": -0.15, "coulomb_slope": -0.08, "reference_temperature": 30.0},
        MOTOR,
        0.03,
        5.0,
    ),
    "torque_constant_error": Case(Changes(motor=lambda u: 1.06 * u), {"torque_constant_error": 0.06}, MOTOR, 0.03, 5.0),
    "torsional_hysteresis": Case(
        Changes(hysteresis=(6000.0, 1.2e4)),
        {"hysteresis_stiffness": 6000.0, "hysteresis_rate": 1.2e4},
        TRANSMISSION,
        0.05,
        5.0,
    ),
}
NEAR_REVERSALS = {name for name, effect in library().items() if effect.near_reversals}
"""Tested in test_near_reversals."""


def test_every_effect_that_can_be_missing_has_a_joint_here() -> None:
    missing = {name for name, effect in library().items() if not effect.in_every_model} - NEAR_REVERSALS
    assert missing == set(CASES)


@pytest.mark.parametrize("name", sorted(CASES))
def test_the_column_brings_back_what_was_put_in(name: str) -> None:
    """Cosine and sine of one wave err by a share of its amplitude; what the shape says is put in, not found."""
    case, effect = CASES[name], effect_named(name)
    assert set(case.values) <= {parameter.name for parameter in effect.parameters}
    recorded = with_noise(simulate(case.changes, tones=case.tones))
    equations = build_equations(recorded, known(), link_of(recorded))
    truth = Context(PLAIN.stiffness, PLAIN.coulomb, equations.states.torque_scale)
    shape, _ = effect.split(case.values, truth)
    fit, (before, after) = fitted(equations, Candidate(name, effect.columns(equations.states, shape), effect, shape))
    found = fit.parameters(fit.selection[0], truth)
    waves = [abs(v) for n, v in case.values.items() if n.startswith(("cosine", "sine"))]
    for parameter, value in case.values.items():
        size = math.hypot(*waves) if parameter.startswith(("cosine", "sine")) else abs(value)
        assert found[parameter] == pytest.approx(value, abs=case.error * size), parameter
    assert before[case.channel] > case.gain * after[case.channel]
    if TRANSMISSION not in effect.columns(equations.states, shape):
        assert before[TRANSMISSION] == after[TRANSMISSION], "it acts elsewhere only"
    # Beside it the values of every joint are those of the plain one; a gauge's gain hides in the stiffness.
    assert fit.rotor_inertia == pytest.approx(PLAIN.rotor_inertia, rel=2e-3)
    assert fit.coulomb_torque == pytest.approx(PLAIN.coulomb, rel=2e-3)
    gain = 1.05 if name == "gauge_gain" else 1.0
    assert fit.torsional_stiffness == pytest.approx(gain * PLAIN.stiffness, rel=5e-4)
    assert fit.link_inertia_scale == pytest.approx(1.0, rel=2e-3)


def fitted(equations: JointEquations, candidate: Candidate) -> tuple[Fit, tuple[dict[str, float], dict[str, float]]]:
    """The fit with one effect on the rows at which its law holds; held-out errors by channel without and with it."""
    dictionary = build(equations, [candidate])
    blind = blind_rows(dictionary, dictionary.groups)
    dictionary = dictionary.without_rows(blind) if blind else dictionary
    scores, groups = Scores(dictionary), dictionary.groups
    raw = RawRows(dictionary, groups)
    errors = raw.held_out_errors(scores, ()), raw.held_out_errors(scores, groups)
    return Fit.of(dictionary, scores, groups), errors


@pytest.mark.parametrize("name", ["asymmetric_friction", "kinematic_error", "payload"])
def test_a_column_with_the_other_sign_or_another_shape_does_not(name: str) -> None:
    """The check above can fail: the mirrored column gives the mirrored value, a shifted one does not close."""
    case, effect = CASES[name], effect_named(name)
    recorded = with_noise(simulate(case.changes, tones=case.tones))
    equations = build_equations(recorded, known(), link_of(recorded))
    shape, _ = effect.split(case.values, Context(PLAIN.stiffness, PLAIN.coulomb, equations.states.torque_scale))
    columns = effect.columns(equations.states, shape)
    right, (_, least) = fitted(equations, Candidate(name, columns, effect, shape))
    mirrored, _ = fitted(equations, Candidate(name, {n: -c for n, c in columns.items()}, effect, shape))
    own = right.selection[0].index
    np.testing.assert_allclose(mirrored.coefficients[own], -right.coefficients[own], rtol=1e-6)
    late = {n: np.roll(c, 100, axis=0) for n, c in columns.items()}
    _, (_, after) = fitted(equations, Candidate(name, late, effect, shape))
    assert after[case.channel] > (1.02 if name == "payload" else 1.5) * least[case.channel]
