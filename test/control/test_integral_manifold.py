"""Integral-manifold law: each term against the paper's equations written down once more, derivatives by difference."""

import math

import numpy as np
import pytest
from oracles.manifold_law import Joint

from hd_control.control import integral_manifold as law
from hd_control.control import torque
from hd_control.core.errors import ConfigError
from hd_control.reproduce.constants import load_constants
from hd_control.reproduce.gandhi_runs import Experiment, law_values

DT = 1e-4
N = 50.0


def values(**changes):
    return {**law_values(load_constants("gandhi"), Experiment(prediction=0.0)), **changes}


@pytest.fixture
def joint():
    c = load_constants("gandhi")
    given = law.configure(values(), None, DT)
    return Joint(
        J_m=c["rotor_inertia"], B_m=c["rotor_damping"], J_l=c["link_inertia"], B_l=c["link_damping"], N=N,
        K=c["stiffness_linear"], A=c["hysteresis_stiffness"], alpha=c["hysteresis_rate"],
        K_1=c["perturbation_stiffness"], Lambda=c["tracking_gain"], k_d=c["tracking_damping"],
        K_D=given.fast_gain.item(), a=c["kinematic_cosine"], b=c["kinematic_sine"],
    )  # fmt: skip


def reference_at(t):
    """A smooth motion and load with all derivatives: r .. r'''', tau_l .. tau_l''."""
    s, c = math.sin(9 * t + 0.3), math.cos(9 * t + 0.3)
    u, v = math.sin(3 * t + 1.0), math.cos(3 * t + 1.0)
    return np.array(
        [0.2 * s + t, 1.8 * c + 1.0, -16.2 * s, -145.8 * c, 1312.2 * s, 20 * u, 60 * v, -180 * u],
    )


def ask(joint, m, link, rate, m_rate, q, want, **changes):
    """The law's output for one state with the hysteresis torque given; motor side in, output side out."""
    params = law.configure(values(**changes), None, DT)
    state = law.initial_state(params)
    state.started, state.hysteresis_torque = 1.0, -q
    state.torsion_last = m / N - link - joint.theta_p(m)
    sample, reference = law.new_sample(1), law.new_reference(1)
    sample.array[:] = link, rate, math.nan, m / N, m_rate / N, 0.0
    reference.array[:] = want
    return law.step(params, state, sample, reference, DT)[0]


def draw(rng):
    m, link = rng.uniform(0, 6.28), rng.uniform(-0.2, 0.2)
    return m, link, rng.uniform(-2, 4), rng.uniform(-100, 200), rng.uniform(-12, 12), rng.uniform(0, 3)


def test_tau_0_h_0_and_the_fast_term_are_the_papers(joint, rng):
    for _ in range(200):
        m, link, rate, m_rate, q, t = draw(rng)
        want = reference_at(t)
        out = ask(joint, m, link, rate, m_rate, q, want)
        four = (*want[:3], want[5])
        assert out.slow_term_0.item() / N == pytest.approx(joint.tau_0(m, link, rate, four), rel=1e-10, abs=1e-10)
        assert out.manifold_torque.item() == pytest.approx(joint.h_0(m, link, rate, q, four), rel=1e-9, abs=1e-9)
        assert out.fast_term.item() / N == pytest.approx(joint.fast(m, m_rate, rate), rel=1e-9, abs=1e-9)
        assert out.damping_term.item() / N == pytest.approx(joint.B_m * m_rate, rel=1e-12)


def along_the_manifold(joint, name, m, link, rate, q, t):
    """The value named, and its rate by central difference along the flow of the slow variables."""
    want, step, ends = reference_at(t), 1e-6, []
    here = ask(joint, m, link, rate, 0.0, q, want)
    flow = joint.slow_rates(m, link, rate, q, (*want[:3], want[5]), here.manifold_torque_rate.item())
    for sign in (-1.0, 1.0):
        a, b, c, d = np.array([m, link, rate, q]) + sign * step * flow
        ends.append(ask(joint, a, b, c, 0.0, d, reference_at(t + sign * step)).view(name).item())
    return here, (ends[1] - ends[0]) / (2 * step)


def test_the_rate_of_h_0_is_that_along_the_manifold(joint, rng):
    for _ in range(60):
        m, link, rate, _, q, t = draw(rng)
        here, slope = along_the_manifold(joint, "manifold_torque", m, link, rate, q, t)
        assert here.manifold_torque_rate.item() == pytest.approx(slope, rel=1e-5, abs=1e-3)


def test_its_second_rate_is_exact_where_the_joint_follows_the_reference(joint, rng):
    """Away from it the law leaves out how the error decays: that part dies with the error."""
    for _ in range(60):
        m, _, _, _, q, t = draw(rng)
        link, rate = reference_at(t)[:2]
        here, slope = along_the_manifold(joint, "manifold_torque_rate", m, link, rate, q, t)
        assert here.manifold_torque_acceleration.item() == pytest.approx(slope, rel=1e-4, abs=0.05)


def test_the_rates_hold_with_a_polynomial_spring(joint, rng):
    """The tangent at the torsion takes the place of K; here the wind-up follows from h_0 by the plant's own spring."""
    cubic, quintic, step = 1e8, 1e13, 1e-6
    spring = {"stiffness_cubic": [cubic], "stiffness_quintic": [quintic]}
    for _ in range(40):
        m, _, _, _, q, t = draw(rng)
        wind, want = rng.uniform(-2e-3, 2e-3), reference_at(t)
        ends = []
        joint.K = 1e4 + 3 * cubic * wind**2 + 5 * quintic * wind**4
        link = wind + m / N - joint.theta_p(m)
        here = ask(joint, m, link, want[1], 0.0, q, np.array([link, *want[1:]]), **spring)
        h1 = here.manifold_torque_rate.item()
        rates = joint.slow_rates(m, link, want[1], q, (link, *want[1:3], want[5]), h1)
        for sign in (-1.0, 1.0):
            later = reference_at(t + sign * step)
            moved = np.array([m, link, want[1], q]) + sign * step * rates
            # The rotor angle that gives the wind-up of the manifold; the kinematic error's slope is in the rates.
            shifted = wind - sign * step * h1 / joint.K
            rotor = moved[0]
            for _ in range(30):
                rotor = N * (moved[1] - shifted + joint.theta_p(rotor))
            wanted_there = np.array([moved[1], *later[1:]])
            out = ask(joint, rotor, moved[1], later[1], 0.0, moved[3], wanted_there, **spring)
            ends.append(out.manifold_torque_rate.item())
        assert here.manifold_torque_acceleration.item() == pytest.approx(
            (ends[1] - ends[0]) / (2 * step), rel=2e-3, abs=1.0
        )


def test_tau_1_tau_2_tau_4_follow_from_the_derivatives(joint, rng):
    for _ in range(100):
        m, link, rate, m_rate, q, t = draw(rng)
        out = ask(joint, m, link, rate, m_rate, q, reference_at(t))
        h1, h2 = out.manifold_torque_rate.item(), out.manifold_torque_acceleration.item()
        for name, wanted in zip(("1", "2", "4"), joint.slow(m, rate, h1, h2), strict=True):
            assert out.view(f"slow_term_{name}").item() / N == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_composition_adds_term_by_term(joint, rng):
    m, link, rate, m_rate, q, t = draw(rng)
    outs = {c: ask(joint, m, link, rate, m_rate, q, reference_at(t), composition=c) for c in law.COMPOSITIONS}
    terms = ("slow_term_1", "slow_term_2", "slow_term_4")
    for k, name in enumerate(("tau_0", "tau_1", "tau_2", "all")):
        present = [outs[name].view(term).item() != 0.0 for term in terms]
        assert present == [True] * k + [False] * (3 - k)
        parts = ("damping_term", "fast_term", "slow_term_0", *terms)
        assert outs[name].motor_torque.item() == pytest.approx(sum(outs[name].view(p).item() for p in parts), rel=1e-14)


def test_the_comparison_law_is_31_with_the_load_once(joint, rng):
    for _ in range(50):
        m, link, rate, m_rate, q, t = draw(rng)
        want = reference_at(t)
        r, r1, r2, load = *want[:3], want[5]
        e, e1 = link - r, rate - r1
        rigid = (joint.J_l + joint.J_m * N**2) * (r2 - joint.Lambda * e1) + joint.B_l * (r1 - joint.Lambda * e)
        inside = rigid - joint.k_d * (e1 + joint.Lambda * e) + load
        k_f = joint.K_D * math.sqrt(joint.K_1 / joint.K) * joint.K
        wanted = joint.B_m * m_rate + inside / N + k_f * (rate - m_rate / N)
        out = ask(joint, m, link, rate, m_rate, q, want, composition="comparison")
        assert out.motor_torque.item() / N == pytest.approx(wanted, rel=1e-11)


def test_fast_gain_gives_the_fast_mode_its_damping():
    c = load_constants("gandhi")
    gain = law.configure(values(), None, DT).fast_gain.item()
    assert gain == pytest.approx(0.144, abs=5e-4)  # the paper's constants with a damping ratio of 0.7
    # Rotor and link on the spring, K_f (theta_l' - theta_m'/N) at the motor: damping of the torsion mode.
    rotor, stiffness = c["rotor_inertia"] * N**2, c["stiffness_linear"]
    frequency = math.sqrt(stiffness * (1.0 / rotor + 1.0 / c["link_inertia"]))
    damping = N * gain * math.sqrt(c["perturbation_stiffness"] * stiffness)
    assert damping / rotor == pytest.approx(2.0 * 0.7 * frequency, rel=1e-9)


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
