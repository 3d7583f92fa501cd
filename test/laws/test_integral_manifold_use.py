"""The integral-manifold law in use: prediction, wanted motion, filters, limits, bad values."""

import math

import numpy as np
import pytest
from manifold_cases import DT, N, ask, drive, reference_at, values

from hd_control.core.errors import ConfigError
from hd_control.laws import integral_manifold as law
from hd_control.laws import torque


@pytest.fixture
def joint():
    return drive()


def test_prediction_is_the_plant_ahead(joint):
    """The predicted motion is that of an independent integration of (8)-(10) with the held command."""
    m, link, rate, m_rate, q, t = 1.3, 0.026 + 0.001, 1.2, 61.0, 4.0, 0.4
    want, ahead = reference_at(t), 1.5 * DT
    params = law.configure(values(prediction_samples=1.5), None, DT)
    state, sample, reference = law.initial_state(params), law.new_sample(1), law.new_reference(1)
    state.started, state.hysteresis_torque, state.motor_torque_last = 1.0, -q, 30.0
    state.torsion_last = -joint.theta(m, link)
    sample.array[:], reference.array[:] = (link, rate, 0.0, m / N, m_rate / N, 0.0), want
    out = law.step(params, state, sample, reference, DT)[0]
    now, steps = np.array([m, m_rate, link, rate, q]), 2000
    h = ahead / steps
    for k in range(steps):
        load = want[5] + want[6] * (k + 0.5) * h + want[7] * ((k + 0.5) * h) ** 2 / 2
        half = now + h / 2 * joint.plant_rates(now, 30.0 / N, load, lambda x: joint.K * x)
        now = now + h * joint.plant_rates(half, 30.0 / N, load, lambda x: joint.K * x)
    assert out.predicted_joint_position.item() == pytest.approx(now[2], abs=1e-10)
    assert out.predicted_motor_position.item() == pytest.approx(now[0] / N, abs=1e-10)
    assert -out.hysteresis_torque.item() == pytest.approx(now[4], abs=1e-5)


def test_hysteresis_of_the_wanted_motion_needs_no_torsion(joint):
    """Along a wanted motion the torque of spring and hysteresis is the wanted one; coarse sensors do not touch it."""
    params = law.configure(values(hysteresis_source="wanted"), None, DT)
    state, sample, reference = law.initial_state(params), law.new_sample(1), law.new_reference(1)
    largest = 0.0
    for k in range(12000):
        reference.array[:] = want = reference_at(k * DT)
        sample.joint_position = sample.motor_position = round(want[0] / 1e-3) * 1e-3
        out, state = law.step(params, state, sample, reference, DT)
        largest = max(largest, abs(out.hysteresis_torque.item()))
    wanted = joint.J_l * want[2] + joint.B_l * want[1] + want[5]
    first = joint.J_l * reference_at(0)[2] + joint.B_l * reference_at(0)[1] + reference_at(0)[5]
    grown = joint.K * state.wanted_torsion.item() + out.hysteresis_torque.item()
    assert grown == pytest.approx(wanted - first, abs=0.05)  # it starts from the gauge, at zero
    assert 3.0 < largest < joint.A / joint.alpha


@pytest.mark.parametrize("speed", [0.5, -1.5])
def test_error_filter_takes_the_lag_out_of_the_rates(joint, speed):
    """Rates behind D as the fusion law forms them; the rotor moves against the kinematic error. 1 kHz."""
    dt, found = 1e-3, {}
    for source in ("plain", "error_filter"):
        params = law.configure(values(rate_source=source, derivative_cutoff=200.0), None, dt)
        state, sample, reference = law.initial_state(params), law.new_sample(1), law.new_reference(1)
        last, rate, worst = None, np.zeros(2), 0.0
        for k in range(1500):
            r = 0.2 * math.sin(6.0 * k * dt) + speed * k * dt
            r1 = 1.2 * math.cos(6.0 * k * dt) + speed
            rotor = r
            for _ in range(20):
                rotor = r + joint.theta_p(N * rotor)
            seen = np.array([r, rotor])
            rate = 0.8 * rate + 0.2 * (seen - (seen if last is None else last)) / dt
            last = seen
            reference.array[:] = (r, r1, -36 * 0.2 * math.sin(6.0 * k * dt), 0, 0, 0, 0, 0)
            sample.array[:] = (r, rate[0], 0.0, rotor, rate[1], 0.0)
            out, state = law.step(params, state, sample, reference, dt)
            if k > 200:
                rotor_rate = r1 / (1.0 - N * joint.theta_p(N * rotor, 1))
                worst = max(worst, abs(out.damping_term.item() / N**2 / joint.B_m - rotor_rate))
        found[source] = worst
    assert found["error_filter"] < 0.02 * found["plain"]


def test_coulomb_friction_is_fed_forward_in_the_wanted_direction(joint):
    for rate, wanted in ((0.5, 3.0), (-0.5, -3.0), (0.0, 0.0)):
        want = np.array([0.0, rate, 0, 0, 0, 0, 0, 0])
        out = ask(joint, 0.0, 0.0, 0.0, 0.0, 0.0, want, rotor_coulomb=[3.0], friction_speed=[0.01])
        assert out.friction_term.item() == pytest.approx(wanted, abs=1e-9)


def test_the_first_sample_takes_the_hysteresis_from_the_gauge(joint):
    params = law.configure(values(), None, DT)
    sample, reference = law.new_sample(1), law.new_reference(1)
    sample.motor_position, sample.joint_torque = 1e-3, 1e-3 * 1e4 + 6.0
    torsion = 1e-3 - joint.theta_p(1e-3 * N)
    out, state = law.step(params, law.initial_state(params), sample, reference, DT)
    assert out.hysteresis_torque.item() == pytest.approx(1e-3 * 1e4 + 6.0 - 1e4 * torsion, abs=1e-9)
    sample.joint_torque = 1e6
    out, _ = law.step(params, law.initial_state(params), sample, reference, DT)
    assert out.hysteresis_torque.item() == pytest.approx(joint.A / joint.alpha, rel=1e-12)
    assert state.started.item() == 1.0


def test_what_is_not_finite_shows_and_leaves_the_memory(joint):
    params = law.configure(values(), None, DT)
    sample, reference = law.new_sample(1), law.new_reference(1)
    _, state = law.step(params, law.initial_state(params), sample, reference, DT)
    sample.joint_position = math.nan
    out, after = law.step(params, state, sample, reference, DT)
    assert not math.isfinite(out.motor_torque.item())
    np.testing.assert_array_equal(after.array, state.array)


def test_the_limit_is_a_term(joint):
    out = ask(joint, 0.0, 0.5, 0.0, 0.0, 0.0, reference_at(0.0), motor_torque_limit=[2.0])
    assert abs(out.motor_torque.item()) == 2.0
    free = ask(joint, 0.0, 0.5, 0.0, 0.0, 0.0, reference_at(0.0))
    assert out.saturation_torque.item() == pytest.approx(-2.0 - free.motor_torque.item(), rel=1e-12)


def test_the_chains_reference_gives_the_same_as_closed_forms():
    """Derivatives of the wanted velocity by difference; a gravity load as a function of the wanted position."""
    dt = 1e-3
    changes = {"load_constant": [3.0], "load_cosine": [4.0], "load_sine": [-5.0]}
    params = law.configure(values(**changes), None, dt)
    chain, closed = law.initial_state(params), law.initial_state(params)
    sample, full, plain = law.new_sample(1), law.new_reference(1), torque.new_reference(1)
    for k in range(200):
        want = reference_at(k * dt)
        plain.desired_position, plain.desired_velocity = want[0], want[1]
        c, s = math.cos(want[0]), math.sin(want[0])
        load, slope, bend = 3.0 + 4.0 * c - 5.0 * s, -4.0 * s - 5.0 * c, -4.0 * c + 5.0 * s
        full.array[:] = (*want[:5], load, slope * want[1], slope * want[2] + bend * want[1] ** 2)
        sample.joint_position, sample.motor_position = want[0], want[0]
        sample.joint_velocity = sample.motor_velocity = want[1]
        from_chain, chain = law.step(params, chain, sample, plain, dt)
        from_full, closed = law.step(params, closed, sample, full, dt)
    for name in ("slow_term_0", "slow_term_1", "slow_term_2", "motor_torque"):
        a, b = from_chain.view(name).item(), from_full.view(name).item()
        assert a == pytest.approx(b, rel=5e-3, abs=0.05)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"link_inertia": [0.0]}, "joint: the integral-manifold law needs link_inertia above 0"),
        ({"composition": "tau_3"}, "composition: 'tau_3' is not one of comparison, tau_0, tau_1, tau_2, all"),
        ({"perturbation_stiffness": [0.0]}, "perturbation_stiffness"),
        ({"prediction_samples": 9.0}, "prediction_samples: 9 is outside"),
    ],
)
def test_bad_values_are_named(change, text):
    with pytest.raises(ConfigError, match=text.replace("(", r"\(")):
        law.configure(values(**change), None, DT)
