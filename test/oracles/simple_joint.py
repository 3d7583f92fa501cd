"""A joint of two masses, integrated as plainly as possible: rotor, spring with damper, link under gravity.

    I phi'' = u - F(phi') - Y tau        F: Coulomb friction, a set at standstill, and viscous friction
    J q''   = tau - g sin q - F_link     tau = f(delta) + c delta',  delta = phi + KE(N phi) - q,  Y = 1 + N KE'

Leapfrog with `SUBSTEPS` steps per sample: velocities at half steps, one `for` loop in plain numbers. Nothing of the
world or of the model is used. What a test wants to change is a function of `Changes`; without them the joint is the one
that every model describes. Signals carry no noise; `with_noise` adds white noise that is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.signals.joint_signals import JointSignals

PERIOD, SUBSTEPS = 1e-3, 5
"""s per sample. The spring turns by 0.05 rad per step: its frequency is right within 1e-4, that of 3 Hz within 1e-8."""
RATIO = 100.0


@dataclass(frozen=True)
class Joint:
    """Inertias kg m^2, gravity N m, friction N m and N m s, spring N m/rad and its damping time s; output side."""

    rotor_inertia: float = 0.8
    link_inertia: float = 1.1
    gravity: float = 45.0
    coulomb: float = 4.0
    viscous: float = 8.0
    stiffness: float = 2.5e4
    damping_time: float = 8e-4


def _nothing(*_: float) -> float:
    return 0.0


@dataclass(frozen=True)
class Changes:
    """What differs from the plain joint. Torques N m resist; angles rad; `phi` rotor angle on the output side.

    `coulomb(phi', tau, t)` is added to the Coulomb level, `rotor(phi, phi', tau, t)` and `link(q, q')` are torques,
    `spring(delta)` takes the place of k delta, `kinematic(theta)` gives KE and its slope over theta, `motor(u)` the
    torque that acts, `late` samples later; `gauge(tau, phi, q)` and `joint_sensor(q)` are what the sensors read;
    `temperature(t)` deg C. `bristle` rad: travel over which Coulomb friction builds up, 0: at once.
    `hysteresis` (A N m/rad, alpha 1/rad): h' = A delta' - alpha |delta'| h is added to tau.
    `hanging` (share of the link inertia, rad/s, damping ratio): it hangs on a spring of its own.
    """

    coulomb: Callable[[float, float, float], float] = _nothing
    rotor: Callable[[float, float, float, float], float] = _nothing
    link: Callable[[float, float], float] = _nothing
    spring: Callable[[float], float] | None = None
    kinematic: Callable[[float], tuple[float, float]] | None = None
    motor: Callable[[float], float] | None = None
    late: int = 0
    gauge: Callable[[float, float, float], float] | None = None
    joint_sensor: Callable[[float], float] | None = None
    temperature: Callable[[float], float] | None = None
    bristle: float = 0.0
    hysteresis: tuple[float, float] = (0.0, 0.0)
    hanging: tuple[float, float, float] = (0.0, 1.0, 0.0)


GENERAL = tuple((0.28 * (0.07 / f) ** 1.4 + 0.004, f) for f in (0.07 * 1.29**i for i in range(15)))
"""Amplitude rad and frequency Hz of the sines of a motion with many speeds, reversals and loads, 0.07 to 2.5 Hz."""


Tones = tuple[tuple[float, float], ...]


def reference(time: FloatArray, tones: Tones = GENERAL) -> tuple[FloatArray, ...]:
    """Position, velocity and acceleration (n,) each; from rest within the first second."""
    start = np.minimum(time, 1.0)
    ease = start**4 * (35.0 - 84.0 * start + 70.0 * start**2 - 20.0 * start**3)  # three derivatives vanish at its ends
    whole = sum(a * np.sin(2.0 * np.pi * f * time + 0.9 * i**2) for i, (a, f) in enumerate(tones))
    position = ease * whole
    velocity = np.gradient(position, time)
    return position, velocity, np.gradient(velocity, time)


@lru_cache(maxsize=64)
def simulate(
    changes: Changes = Changes(),
    joint: Joint = Joint(),
    seconds: float = 30.0,
    tones: Tones = GENERAL,
) -> JointSignals:
    """The joint under a servo on its own states that follows `reference`; signals as a recording gives them."""
    c, k, damper = changes, joint.stiffness, joint.stiffness * joint.damping_time
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    wanted = zip(*(x.tolist() for x in reference(time, tones)), strict=True)
    h, inertia = PERIOD / SUBSTEPS, joint.rotor_inertia
    share, omega, zeta = c.hanging
    own_link, hung = joint.link_inertia * (1.0 - share), joint.link_inertia * share
    phi = phi_rate = q = q_rate = loop = bristle = hang = hang_rate = tau = 0.0
    line, acting, rows = [0.0] * (c.late + 1), 0.0, []
    for n, (position, velocity, acceleration) in enumerate(wanted):
        t = n * PERIOD
        feed = (inertia + joint.link_inertia) * acceleration + joint.gravity * math.sin(position)
        u = feed + 400.0 * (position - phi) + 40.0 * (velocity - phi_rate) + joint.viscous * velocity
        line = [u, *line[:-1]]
        before, acting = acting, line[-1] if c.motor is None else c.motor(line[-1])
        for step in range(SUBSTEPS):
            error, slope = c.kinematic(RATIO * phi) if c.kinematic else (0.0, 0.0)
            lever = 1.0 + RATIO * slope
            delta, rate = phi + error - q, lever * phi_rate - q_rate
            loop += h * (c.hysteresis[0] * rate - c.hysteresis[1] * abs(rate) * loop)
            tau = (c.spring(delta) if c.spring else k * delta) + damper * rate + loop
            if step == 0:
                rows.append((RATIO * phi, q, tau, u))
            drive = acting if step else 0.5 * (before + acting)  # half of the first kick belongs to the tick before
            level = joint.coulomb + c.coulomb(phi_rate, tau, t)
            push = drive - lever * tau - joint.viscous * phi_rate - c.rotor(phi, phi_rate, tau, t)
            if c.bristle > 0.0:
                bristle += h / c.bristle * (phi_rate - abs(phi_rate) * bristle)
                phi_rate += h / inertia * (push - level * bristle)
            else:
                free, stop = phi_rate + h / inertia * push, h / inertia * level
                phi_rate = free - min(max(free, -stop), stop)
            pull = hung * (omega**2 * (hang - q) + 2.0 * zeta * omega * (hang_rate - q_rate))
            weight = joint.gravity * math.sin(q)
            q_rate += h / own_link * (tau - (1.0 - share) * weight - c.link(q, q_rate) + pull)
            if share > 0.0:
                hang_rate -= h * (pull / hung + weight / joint.link_inertia)
                hang += h * hang_rate
            phi, q = phi + h * phi_rate, q + h * q_rate
    shaft, q_rows, tau_rows, u_rows = np.array(rows).T
    read_joint = q_rows if c.joint_sensor is None else np.array([c.joint_sensor(x) for x in q_rows.tolist()])
    gauge = tau_rows
    if c.gauge is not None:
        every = zip(tau_rows.tolist(), (shaft / RATIO).tolist(), q_rows.tolist(), strict=True)
        gauge = np.array([c.gauge(*row) for row in every])
    warm = None if c.temperature is None else np.array([c.temperature(x) for x in time.tolist()])
    return JointSignals(
        "joint_1", time, PERIOD, np.ones(time.size, dtype=bool), shaft, read_joint, gauge, u_rows, warm
    )  # fmt: skip


NOISE = {"motor_shaft_position": 2e-4, "joint_position": 4e-6, "gauge_torque": 0.02}
"""White noise of a good recording, standard deviations: rad before the gear, rad, N m."""


def with_noise(signals: JointSignals, levels: Mapping[str, float] = NOISE, seed: int = 0) -> JointSignals:
    """The signals with white noise of known standard deviation."""
    random = np.random.default_rng(seed)
    noisy = {name: getattr(signals, name) + level * random.standard_normal(signals.time.size)
             for name, level in levels.items()}  # fmt: skip
    return replace(signals, **noisy)
