"""The integral-manifold law and its oracle on the paper's drive, for the tests of both."""

import math

import numpy as np
from oracles.manifold_law import Joint

from hd_control.laws import integral_manifold as law
from hd_control.papers.gandhi_runs import Experiment, law_values
from hd_control.papers.rows import load_constants

DT = 1e-4
N = 50.0


def values(**changes):
    return {**law_values(load_constants("gandhi"), Experiment(prediction=0.0)), **changes}


def drive():
    """The oracle with the constants of the paper's drive."""
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
