"""Torque-feedback law: Hashimoto (19) term by term, its integral, its limits, and the loop that it closes."""

import math

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_control.laws import torque
from hd_control.laws import torque_feedback as law
from hd_control.papers.hashimoto_runs import TorqueExperiment, law_values
from hd_control.papers.rows import load_constants

DT = 5e-4
J, K, KP, KD = 0.94, 8800.0, 46808.0, 234.0


def values(*, locked=False, **changes):
    given = law_values(load_constants("hashimoto"), TorqueExperiment("step", "paper", locked))
    return {**given, **{name: value if name == "setpoint_kick" else [value] for name, value in changes.items()}}


def ask(params, state, torque_now, wanted):
    sample, reference = law.new_sample(1), law.new_reference(1)
    sample.joint_torque = torque_now
    reference.array[:] = wanted
    return law.step(params, state, sample, reference, DT)


def test_every_term_is_the_papers(rng):
    """The rate of the joint torque is a filtered difference, the integral a sum: both written down once more here."""
    params = law.configure(values(feedback_integral=2e5, feedback_friction=3.6, feedback_friction_rate=2.0), None, DT)
    state, pole = law.initial_state(params), math.exp(-1500.0 * DT)
    last, rate, integral = None, 0.0, 0.0
    for _ in range(200):
        now, wanted = rng.uniform(-5, 5), rng.uniform(-5, 5, 3) * (1.0, 100.0, 1e4)
        out, state = ask(params, state, now, wanted)
        rate = 0.0 if last is None else pole * rate + (1 - pole) * (now - last) / DT
        last, integral = now, float(np.clip(integral + DT * (wanted[0] - now), *(np.array([-1, 1]) * 10 * K / J / 2e5)))
        terms = {
            "acceleration_term": J / K * wanted[2],
            "rate_term": J / K * KD * (wanted[1] - rate),
            "proportional_term": J / K * KP * (wanted[0] - now),
            "integral_term": J / K * 2e5 * integral,
            "feedforward_term": wanted[0] * (1 + J / 0.88),
            "friction_term": 3.6 * math.tanh(wanted[1] / 2.0),
        }
        for name, value in terms.items():
            assert out.view(name).item() == pytest.approx(value, rel=1e-9, abs=1e-9), name
        assert out.motor_torque.item() == pytest.approx(sum(terms.values()), rel=1e-9)


def test_a_locked_link_has_no_share_of_the_inertia():
    out, _ = ask(*_fresh(locked=True), 0.0, (5.0, 0.0, 0.0))
    assert out.feedforward_term.item() == 5.0


def _fresh(**changes):
    params = law.configure(values(**changes), None, DT)
    return params, law.initial_state(params)


def test_the_integral_stops_at_its_limit_and_at_the_drives():
    params, state = _fresh(feedback_integral=1e6, feedback_integral_limit=3.0)
    for _ in range(400):
        out, state = ask(params, state, 0.0, (5.0, 0.0, 0.0))
    assert out.integral_term.item() == pytest.approx(3.0, rel=1e-12)
    params, state = _fresh(
        feedback_integral=1e6, feedback_integral_limit=1e3, motor_torque_limit=2.0, feedback_rate=0.0
    )
    for _ in range(400):
        out, state = ask(params, state, 0.0, (5.0, 0.0, 0.0))
        assert out.motor_torque.item() == 2.0
    assert state.integral.item() == 0.0  # it never moved further into the limit
    _, back = ask(params, state, 5.5, (5.0, 0.0, 0.0))
    assert back.integral.item() < 0.0


def test_what_is_not_finite_shows_and_leaves_the_memory():
    params, state = _fresh()
    _, state = ask(params, state, 1.0, (2.0, 0.0, 0.0))
    out, after = ask(params, state, math.nan, (2.0, 0.0, 0.0))
    assert math.isnan(out.motor_torque.item())
    np.testing.assert_array_equal(after.array, state.array)


@pytest.mark.parametrize("kick", [True, False])
def test_the_chain_gives_the_required_torque_alone(kick):
    params, state = _fresh(setpoint_kick=kick)
    sample, reference = law.new_sample(1), torque.new_reference(1)
    w, rates = 2 * math.pi * 5.0, []
    for k in range(400):
        reference.joint_torque_required = 4.0 * math.sin(w * k * DT)
        out, state = law.step(params, state, sample, reference, DT)
        rates.append(out.required_torque_rate.item())
    time = np.arange(400) * DT
    wanted = 4.0 * w * np.cos(w * (time - DT / 2)) if kick else 0.0 * time
    np.testing.assert_allclose(rates[2:], wanted[2:], atol=0.05)


def test_static_error_is_formula_20():
    assert law.static_error(4.0, K, J, 0.0, KP) == pytest.approx(4.0 / (J * KP / K + 1.0), rel=1e-12)
    assert law.static_error(4.0, K, J, 0.88, KP) == pytest.approx(4.0 / (J * KP / K + 1.0 + J / 0.88), rel=1e-12)


def test_bad_values_are_named():
    with pytest.raises(ConfigError, match="feedback_proportional"):
        law.configure(values(feedback_proportional=-1.0), None, DT)
    with pytest.raises(ConfigError, match="torque_rate_cutoff 9000 rad/s is not below 6283"):
        law.configure({**values(), "torque_rate_cutoff": 9000.0}, None, DT)
