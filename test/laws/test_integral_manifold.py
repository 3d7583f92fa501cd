"""Integral-manifold law: each term against the paper's equations written down once more, derivatives by difference."""

import math

import numpy as np
import pytest
from manifold_cases import DT, N, ask, draw, drive, reference_at, values

from hd_control.laws import integral_manifold as law
from hd_control.papers.rows import load_constants


@pytest.fixture
def joint():
    return drive()


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
