"""Torsion of spring and damper: columns in closed form, first guesses beside a large ripple, what a gauge misreads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, DriveStates
from hd_control.lab.balances.channels import Known
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.balances.torsion import (
    BANDS,
    FAST_PRIOR,
    SIGNAL_DELAY_PRIOR,
    GearWaves,
    compliance_of,
    torsion_band,
    torsion_base,
    with_damping,
    with_lost_torsion,
    with_spring,
)
from hd_control.lab.diagnosis.candidates import misread
from hd_control.lab.signals.filters import Band, Spectral
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


# ---- The columns and corrections alone -------------------------------------------------------------


SPECTRAL = Spectral(20_000, PERIOD)
TONE, SIZE = 7.0, 1.3
"""Hz and N m of a sine that every band here lets through whole."""
BAND = Band(38.0, 60.0, 8)


def sine(states: DriveStates | None = None) -> tuple[DriveStates, np.ndarray]:
    """States whose gauge shows a sine, and the rows at which a filter has forgotten the ends."""
    known = Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3)
    found = build_equations(turning(0.0), known, None).states if states is None else states
    torque = SIZE * np.sin(2.0 * np.pi * TONE * found.time)
    rows = np.arange(0, found.time.size, BAND.step)
    inside = rows[(rows > 600) & (rows < found.time.size - 600)]
    return replace(found, gauge_torque=torque, torsional_compliance=1.0 / STIFFNESS), inside // BAND.step


@pytest.mark.parametrize("damping", [0.0, 1e-3, 5e-3])
def test_columns_of_the_torsion_are_those_of_spring_and_damper(damping: float) -> None:
    """q - phi = -tau / (k (1 + d s)): the column of 1/k is -tau / (1 + d s), that of the change of d over k its
    derivative over d, s tau / (1 + d s)^2."""
    states, inside = sine()
    base = {b.name: b for b in torsion_base(SPECTRAL, states, states.joint_position, BAND, damping)}
    time, omega = states.time[:: BAND.step], 2.0 * np.pi * TONE
    turned = SIZE * np.exp(1j * omega * time)
    lag = 1.0 / (1.0 + 1j * omega * damping)
    expected = {
        "torsional_compliance": -(turned * lag).imag,
        "torsional_damping": (1j * omega * turned * lag**2).imag,
        "transmission_zero": np.ones(time.size),
    }
    for name, column in expected.items():
        scale = np.abs(column).max()
        np.testing.assert_allclose(base[name].column[inside], column[inside], atol=1e-3 * scale)
    step = 1e-6
    moved = torsion_base(SPECTRAL, states, states.joint_position, BAND, damping + step)[0].column
    slope = (moved - base["torsional_compliance"].column) / step
    np.testing.assert_allclose(
        base["torsional_damping"].column[inside], slope[inside], rtol=0.0, atol=0.02 * SIZE * omega
    )
    assert base["joint_delay"].prior == SIGNAL_DELAY_PRIOR and base["torsional_compliance"].prior == np.inf


def test_the_fast_part_of_the_torque_has_a_compliance_of_its_own_with_a_prior() -> None:
    """Above 0.7 of the flat band all of the torque is fast, below 0.45 nothing is."""
    states, inside = sine()
    for tone, fast in ((7.0, 0.0), (33.0, 1.0)):
        torque = np.sin(2.0 * np.pi * tone * states.time)
        base = {b.name: b for b in torsion_base(SPECTRAL, replace(states, gauge_torque=torque), torque, BAND, 0.0)}
        expected = fast * torque[:: BAND.step]
        np.testing.assert_allclose(base["fast_torque"].column[inside], expected[inside], atol=2e-3)
        assert base["fast_torque"].prior == pytest.approx(FAST_PRIOR / STIFFNESS)
    rigid = replace(states, torsional_compliance=0.0)
    assert torsion_base(SPECTRAL, rigid, states.joint_position, BAND, 0.0)[3].prior == np.inf, "no spring, no prior"


def test_the_spring_carries_the_torque_behind_its_damper() -> None:
    states, _ = sine()
    channel = build_equations(turning(0.0), Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3), None).channels[TRANSMISSION]
    found = with_spring(states, SPECTRAL, replace(channel, damping_time=4e-3))
    omega = 2.0 * np.pi * TONE
    expected = (SIZE * np.exp(1j * omega * states.time) / (1.0 + 1j * omega * 4e-3)).imag
    np.testing.assert_allclose(found.spring_torque[600:-600], expected[600:-600], atol=1e-3 * SIZE)
    assert found.damping_time == 4e-3 and found.torsional_compliance == channel.compliance
    assert with_spring(states, SPECTRAL, None) is states


def test_a_torsion_that_is_lost_elsewhere_loads_the_damper_too() -> None:
    """delta = tau_k / k + lost, tau = tau_k + c delta': the spring is left with (tau - c lost') / (1 + d s)."""
    states, _ = sine()
    d, damper = 3e-3, 80.0
    omega, lost_tone = 2.0 * np.pi * TONE, 2.0 * np.pi * 3.0
    lost = 1e-4 * np.sin(lost_tone * states.time)
    found = with_lost_torsion(states, SPECTRAL, d, damper, lost)
    torque = (SIZE * np.exp(1j * omega * states.time) / (1.0 + 1j * omega * d)).imag
    rate = (1j * lost_tone * 1e-4 * np.exp(1j * lost_tone * states.time) / (1.0 + 1j * lost_tone * d)).imag
    np.testing.assert_allclose(found.spring_torque[600:-600], (torque - damper * rate)[600:-600], atol=1e-3)


def test_another_damping_gives_the_columns_of_that_damping() -> None:
    equations = build_equations(turning(0.0), Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3), None)
    moved = with_damping(equations, 4e-3)
    channel = moved.channels[TRANSMISSION]
    expected = torsion_base(equations.spectral, equations.states, equations.derived.filled["joint_position"],
                            channel.band, 4e-3)  # fmt: skip
    for base, other in zip(channel.base, expected, strict=True):
        np.testing.assert_array_equal(base.column, other.column)
    assert channel.damping_time == moved.states.damping_time == 4e-3
    assert moved.states.torsional_compliance == equations.states.torsional_compliance
    assert moved.channels[MOTOR] is equations.channels[MOTOR]


def test_a_first_guess_needs_a_spring_that_pulls_back() -> None:
    channel = build_equations(turning(0.0), Known(RATIO, 1.0, 0.1, 0.1, 0.0, 1e-3), None).channels[TRANSMISSION]
    waves = np.empty((channel.left.size, 0))
    compliance, change = compliance_of(channel, waves)
    assert compliance == pytest.approx(1.0 / STIFFNESS, rel=5e-3) and abs(change) < 1e-4
    assert compliance_of(replace(channel, left=-channel.left), waves) == (0.0, 0.0)
    assert compliance_of(replace(channel, valid=np.zeros_like(channel.valid)), waves) == (0.0, 0.0)


def test_waves_of_the_gear_need_a_few_turns() -> None:
    """Orders 1 to 4, cosine and sine, themselves and their slopes behind the damper: sixteen columns."""
    states, inside = sine()
    waves = GearWaves(SPECTRAL, states, BAND).at(0.0)
    assert waves.shape == (states.time[:: BAND.step].size, 16)
    slow = replace(states, motor_position=0.01 * states.motor_position)
    assert GearWaves(SPECTRAL, slow, BAND).at(0.0).shape[1] == 0
    even = replace(states, motor_position=0.2 * states.time)
    found = GearWaves(SPECTRAL, even, BAND).at(0.0)[inside, 0]
    expected = np.cos(RATIO * 0.2 * states.time[:: BAND.step])[inside]  # 3.2 Hz
    np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.parametrize(("noise", "band"), [(1e-8, BANDS[0]), (1e-3, BANDS[-1])])
def test_the_band_ends_where_the_torque_drowns(noise: float, band: tuple[float, float]) -> None:
    """A torque with power at all frequencies, over the stiffness, against white noise of the torsion."""
    random = np.random.default_rng(4)
    torque = np.cumsum(random.standard_normal(20_000)) * 0.1
    torque -= np.linspace(torque[0], torque[-1], torque.size)
    torsion = -torque / STIFFNESS + noise * random.standard_normal(torque.size)
    found = torsion_band(SPECTRAL, torsion, torque, lambda band: np.ones(torque.size, bool))
    assert (found.flat, found.zero) == band
