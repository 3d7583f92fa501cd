"""The free run against motions with a closed form: no world, no noise, one law at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drive.drive_cases import states_of

from hd_control.core.errors import ConfigError
from hd_control.drive import predict
from hd_control.drive.effect import DriveStates
from hd_control.drive.link import OwnLink
from hd_control.drive.model import JointModel, ModelValue
from hd_control.drive.predict import FreeRun, free_run

ROTOR, LINK = 2.0, 3.0
PERIOD, SAMPLES = 1e-3, 6000
TIME = PERIOD * np.arange(SAMPLES)


def joint(
    stiffness: float = 1e5, coulomb: float = 0.0, viscous: float = 0.0, **effects: dict[str, float]
) -> JointModel:
    """A rotor of 2 kg m^2 and a link of 3 kg m^2."""
    values = {
        "rotor_inertia": {"rotor_inertia": ROTOR},
        "torsional_stiffness": {"torsional_stiffness": stiffness, "damping_time": 0.0},
        "coulomb_friction": {"coulomb_torque": coulomb},
        "viscous_friction": {"viscous": viscous},
        **effects,
    }
    return JointModel(100.0, 50.0, {e: {p: ModelValue(x) for p, x in v.items()} for e, v in values.items()})


def link(rest: Any = 0.0, slope: float = 0.0, n: int = SAMPLES) -> OwnLink:
    """The link alone: tau = 3 q'' + rest + slope (q - measured q)."""
    return OwnLink(np.full(n, LINK), np.broadcast_to(rest, (n,)).copy(), np.full(n, slope))


def motion(phi: np.ndarray, torque: Any = 0.0, motor_torque: Any = 0.0, stiffness: float = 1e5) -> DriveStates:
    """A recording in which the joint lags behind the motor by torque / stiffness."""
    tau = np.broadcast_to(torque, (phi.size,)).astype(float)
    q = phi - tau / stiffness
    rate, joint_rate = np.gradient(phi, PERIOD, edge_order=2), np.gradient(q, PERIOD, edge_order=2)
    return states_of(
        period=PERIOD, gear_ratio=100.0, torque_scale=10.0, time=PERIOD * np.arange(phi.size), motor_position=phi,
        motor_velocity=rate, motor_direction=np.sign(rate), joint_position=q, joint_velocity=joint_rate,
        joint_acceleration=np.gradient(joint_rate, PERIOD), gauge_torque=tau, joint_torque=tau,
        joint_torque_rate=np.gradient(tau, PERIOD, edge_order=2),
        motor_torque=np.broadcast_to(motor_torque, (phi.size,)),
    )  # fmt: skip


def worst(run: FreeRun) -> float:
    """Largest RMS error of the motor position over the largest of holding it."""
    return float(run.rms_motor_position.max() / run.hold_motor_position.max())


def test_two_masses_on_a_spring_keep_their_note() -> None:
    stiffness = (2.0 * np.pi * 8.0) ** 2 * ROTOR * LINK / (ROTOR + LINK)
    wave = np.cos(2.0 * np.pi * 8.0 * TIME + 1.0)
    tau = 5.0 * wave
    phi = tau / stiffness * LINK / (ROTOR + LINK)
    states = motion(phi, tau, stiffness=stiffness)
    run = free_run(joint(stiffness), states, 0.5, 0.25, link())
    # the midpoint rule plays the note flat by (2 pi 8 Hz 1 ms)^2 / 12 = 2.1e-4: 0.0053 rad after 4 turns
    assert worst(run) < 0.01
    assert run.rms_joint_torque.max() < 0.01 * run.hold_joint_torque.max()
    # The link's start velocity is the motor's less the rate of torsion, not that of a slow joint sensor ...
    slow = replace(states, joint_velocity=np.zeros(SAMPLES))
    np.testing.assert_array_equal(
        free_run(joint(stiffness), slow, 0.5, 0.25, link()).rms_motor_position, run.rms_motor_position
    )
    # ... unless the rate of torque is unknown.
    unknown = replace(states, joint_torque_rate=np.full(SAMPLES, np.nan))
    assert worst(free_run(joint(stiffness), unknown, 0.5, 0.25, link())) < 0.01
    assert (
        worst(free_run(joint(stiffness), replace(unknown, joint_velocity=slow.joint_velocity), 0.5, 0.25, link())) > 1.0
    )


def test_a_pendulum_needs_the_slope_of_gravity() -> None:
    rate = 2.0 * np.pi * 1.5
    slope = rate**2 * (ROTOR + LINK)
    phi = 0.1 * np.sin(rate * TIME)
    tau = slope * phi - LINK * rate**2 * phi
    states = motion(phi, tau, stiffness=1e7)
    moving = link(rest=slope * states.joint_position, slope=slope)
    assert worst(free_run(joint(1e7), states, 0.5, 0.25, moving)) < 1e-3
    # A wrong torque: with the slope the pendulum swings about it, on the measured path of gravity it accelerates.
    push = np.full(SAMPLES, 5.0)
    with_slope, without = (
        free_run(joint(1e7), states, 0.5, 0.25, x, command=push)
        for x in (moving, link(rest=slope * states.joint_position))
    )
    final = with_slope.rms_motor_position[-1], without.rms_motor_position[-1]
    expected = 5.0 / slope * (1.0 - np.cos(rate * 0.5)), 0.5 * 5.0 / (ROTOR + LINK) * 0.5**2
    np.testing.assert_allclose(final, expected, rtol=0.01)


def test_friction_stops_the_joint_where_it_must_and_holds_it() -> None:
    speed, coulomb = 0.4, 10.0
    slowing = coulomb / (ROTOR + LINK)
    since = np.maximum(TIME - 2.1, 0.0)  # coasts, from 2.1 s on friction slows it, from 2.3 s on it rests
    until = np.minimum(since, speed / slowing)
    phi = speed * np.minimum(TIME, 2.1) + speed * until - 0.5 * slowing * until**2
    drive = np.where(TIME < 2.1, coulomb, 0.0)
    drive[TIME > 3.0] = 0.9 * coulomb  # below breakaway
    tau = np.where((since > 0.0) & (since < speed / slowing), -LINK * slowing, 0.0)
    tau[TIME > 3.0] = 0.0
    states = motion(phi, tau, drive, stiffness=1e7)
    run = free_run(joint(1e7, coulomb), states, 0.5, 0.25, link())
    # a change of torque inside a step is seen up to one step late: 0.4 rad/s, 1 ms
    assert run.rms_motor_position.max() < 1e-4 < 0.005 * run.hold_motor_position.max()
    still = motion(np.full(SAMPLES, 0.3), 0.0, 0.99 * coulomb)
    held = free_run(joint(1e5, coulomb), still, 0.5, 0.25, link())
    assert held.rms_motor_position.max() == 0.0, "stiction holds exactly"
    slipping = free_run(joint(1e7, coulomb), motion(np.full(SAMPLES, 0.3), 0.0, 10.3), 0.5, 0.25, link())
    np.testing.assert_allclose(slipping.final_motor_position, 0.5 * 0.3 / (ROTOR + LINK) * 0.5**2, rtol=0.02)


def test_windows_that_run_away_are_clipped_and_counted() -> None:
    phi = 0.01 * np.sin(2.0 * np.pi * TIME)
    states = motion(phi)
    run = free_run(joint(), states, 0.5, 0.25, link(), command=np.full(SAMPLES, 1e4))
    assert run.clipped_share == 1.0
    limit = predict.CLIP * run.hold_motor_position.max()
    assert run.rms_motor_position.max() == pytest.approx(limit)
    assert np.abs(run.final_motor_position).max() <= limit * (1.0 + 1e-12)
    broken = free_run(joint(), states, 0.5, 0.25, link(), command=np.full(SAMPLES, 1e300))
    assert broken.clipped_share == 1.0 and np.isfinite(broken.rms_joint_torque).all()
    assert np.isfinite(broken.final_motor_position).all()


def test_holding_the_start_is_the_baseline() -> None:
    phi = 0.1 * np.sin(2.0 * np.pi * 0.7 * TIME)
    run = free_run(joint(), motion(phi), 0.5, 0.25, link())
    starts = np.arange(2000, SAMPLES - 500, 250)
    assert run.windows == starts.size and run.horizon[-1] == pytest.approx(0.5)
    gone = np.array([phi[s : s + 501] - phi[s] for s in starts])
    np.testing.assert_allclose(run.hold_motor_position, np.sqrt((gone**2).mean(axis=0)), rtol=1e-12)


def test_gaps_and_unusable_rows_are_left_out() -> None:
    phi = 0.1 * np.sin(2.0 * np.pi * 0.7 * TIME)
    everything = free_run(joint(), motion(phi), 0.5, 0.25, link())
    usable = np.ones(SAMPLES, dtype=bool)
    usable[3260] = False
    masked = free_run(joint(), motion(phi), 0.5, 0.25, link(), usable=usable)
    gap = motion(phi)
    gap.motor_position[3260] = np.nan
    torn = free_run(joint(), gap, 0.5, 0.25, link())
    lost = link(np.where(np.arange(SAMPLES) == 3260, np.nan, 0.0))  # a neighbour's gap
    assert free_run(joint(), motion(phi), 0.5, 0.25, lost).windows == everything.windows - 2
    assert masked.windows == torn.windows == everything.windows - 2  # starts at 3.0 and 3.25 s
    np.testing.assert_array_equal(masked.rms_motor_position, torn.rms_motor_position)
    usable[:] = False
    with pytest.raises(ConfigError, match="no whole window"):
        free_run(joint(), motion(phi), 0.5, 0.25, link(), usable=usable)
    with pytest.raises(ConfigError, match="no whole window"):
        free_run(joint(), motion(phi[:400]), 0.5, 0.25, link(n=400))


def test_long_windows_take_longer_steps_with_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    n = 12000
    t = PERIOD * np.arange(n)
    phi = 0.1 * np.sin(2.0 * np.pi * 0.3 * t)
    acceleration = -0.1 * (2.0 * np.pi * 0.3) ** 2 * np.sin(2.0 * np.pi * 0.3 * (t + 0.5 * PERIOD))
    usable = t < 11.9
    states = motion(phi, LINK * acceleration, (ROTOR + LINK) * acceleration, stiffness=1e6)
    long, every = predict.HORIZONS[1]
    thin = free_run(joint(1e6), states, long, every, link(n=n), usable=usable)
    monkeypatch.setattr(predict, "LONGEST_STEP", PERIOD)
    full = free_run(joint(1e6), states, long, every, link(n=n), usable=usable)
    assert thin.horizon[1] == 2.0 * full.horizon[1] and thin.windows == full.windows
    assert worst(full) < 1e-3 and worst(thin) < 1e-3


def test_memory_is_replayed_before_every_start() -> None:
    # Forward until 1.9 s, then at rest: the bristles stay bent and balance the motor. Without their past they would
    # give way by half their distance and more.
    values = {"presliding_distance": 1e-3, "presliding_torque": 4.0}
    states = motion(0.5 * np.minimum(TIME, 1.9), 0.0, 4.0, stiffness=1e6)
    run = free_run(joint(1e6, coulomb=4.0, presliding=values), states, 0.5, 0.25, link())
    assert run.windows > 10 and run.rms_motor_position.max() < 1e-9
    # Shaken before each start they are not bent: the motor moves.
    shaken = motion(np.where(TIME < 1.9, 1e-2 * np.sin(30.0 * TIME) * (1.9 - TIME), 0.0), 0.0, 4.0, stiffness=1e6)
    run = free_run(joint(1e6, coulomb=4.0, presliding=values), shaken, 0.5, 0.25, link())
    assert run.rms_motor_position.max() > 2e-4


def test_a_model_without_inertia_or_stiffness_is_refused() -> None:
    states = motion(0.1 * np.sin(TIME))
    with pytest.raises(ConfigError, match="torsional_stiffness and rotor_inertia"):
        free_run(JointModel(100.0), states, 0.5, 0.25, link())
    with pytest.raises(ConfigError, match="link inertia"):
        free_run(joint(), states, 0.5, 0.25)
