"""Torsion of spring and damper: the first guess beside a large ripple of the gauge, and what the gauge misreads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.channels import Known
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.diagnosis.candidates import misread
from hd_control.lab.signals.joint_signals import JointSignals

RATIO, STIFFNESS, DAMPING, PERIOD = 100.0, 3e4, 1.5e-3, 1e-3


def turning(ripple: float) -> JointSignals:
    """A joint under a slow torque; the gauge shows `ripple` N m at twice the rotor angle beside it."""
    time = np.arange(0.0, 20.0, PERIOD)
    motor = 0.5 * np.sin(0.9 * time) + 0.15 * np.sin(2.3 * time)
    torque = 1.5 * np.sin(1.7 * time) + 0.5 * np.sin(9.0 * time)
    tones = ((1.5, 1.7), (0.5, 9.0))
    torsion = sum((size * np.exp(1j * w * time) / (1.0 + 1j * w * DAMPING)).imag for size, w in tones) / STIFFNESS
    shaft = RATIO * motor
    gauge = torque + ripple * np.sin(2.0 * shaft + 0.4)
    return JointSignals(
        joint="joint",
        time=time,
        period=PERIOD,
        valid=np.ones(time.size, dtype=bool),
        motor_shaft_position=shaft,
        joint_position=motor - torsion,
        gauge_torque=gauge,
        motor_torque=torque,
    )


@pytest.mark.parametrize("ripple", [0.0, 0.5, 3.0])
def test_the_first_guess_of_the_spring_stands_beside_a_ripple_larger_than_the_torque(ripple):
    known = Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3)
    channel = build_equations(turning(ripple), known, None).channels[TRANSMISSION]
    assert 1.0 / channel.compliance == pytest.approx(STIFFNESS, rel=0.02)
    assert channel.damping_time == pytest.approx(DAMPING, rel=0.1)


def test_bursts_of_motion_shorter_than_the_whitening_filter_are_not_fitted():
    """0.2 s of motion at a time: 250 rows and more, but none with enough rows before it."""
    whole = turning(0.0)
    speed = np.where(whole.time % 0.5 < 0.2, 0.3, 0.0) * np.sign(np.sin(whole.time))
    motor = np.cumsum(speed) * PERIOD
    assert whole.gauge_torque is not None
    bursts = replace(
        whole, motor_shaft_position=RATIO * motor, joint_position=motor - whole.gauge_torque / STIFFNESS
    )  # fmt: skip
    equations = build_equations(bursts, Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3), None)
    assert (set(equations.channels), equations.too_short) == ({TRANSMISSION}, (MOTOR,))


def test_a_gauge_that_misreads_means_a_torsion_behind_the_damper():
    states = build_equations(turning(0.5), Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3), None).states
    omega = 70.0
    columns = np.stack([np.cos(omega * states.time), np.full(states.time.size, 2.0)], axis=1)
    found = misread(states, columns)
    assert found[MOTOR] is not columns and np.array_equal(found[MOTOR], -columns) and found[LINK] is columns
    answer = np.exp(1j * omega * states.time) / (1.0 + 1j * omega * states.damping_time)
    expected = states.torsional_compliance * (answer.real - np.mean(answer.real))
    settled = slice(int(10 * states.damping_time / PERIOD), None)
    np.testing.assert_allclose(found[TRANSMISSION][settled, 0], expected[settled], atol=2e-3 / STIFFNESS)
    np.testing.assert_allclose(found[TRANSMISSION][:, 1], 0.0, atol=1e-12 / STIFFNESS)
