"""The three balances on a plain joint whose motion obeys them: they close, and what is left is the sensors' noise.

The joint is integrated by `oracles.simple_joint`; nothing of the workbench and nothing of the world makes its signals.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import NOISE, PERIOD, RATIO, simulate, with_noise
from plain_joint import PLAIN, equations, known, link_of, signals

from hd_control.drive.effect import COULOMB, LINK, MOTOR, TRANSMISSION, VISCOUS
from hd_control.lab.balances.channels import Channel, JointEquations
from hd_control.lab.balances.equations import ACCELERATION_SNR, LEAST_ROWS, MOTOR_BANDS, build_equations
from hd_control.lab.balances.torsion import BANDS
from hd_control.lab.signals.filters import Band

TRUE = {
    MOTOR: {"drive_torque": 1.0, COULOMB: PLAIN.coulomb, VISCOUS: PLAIN.viscous},
    TRANSMISSION: {"torsional_compliance": 1.0 / PLAIN.stiffness},
    LINK: {"drive_torque": 1.0},
}
"""Coefficients of the base columns that the joint has; delays, zero and the fast part are 0."""


def residual(channel: Channel, **change: float) -> np.ndarray:
    """Left side minus columns times true coefficients, on the rows that count."""
    values = {**TRUE[channel.name], **change}
    left = channel.left - sum(values.get(base.name, 0.0) * base.column for base in channel.base)
    return np.asarray(left[channel.fitted])


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize(("name", "least"), [(MOTOR, 8e-3), (TRANSMISSION, 1e-4), (LINK, 5e-4)])
def test_each_balance_closes_without_noise(name: str, least: float) -> None:
    """Of the left side. On the rotor a stop is known to the light filter's milliseconds, on the link the sine of the
    filtered angle stands for the filtered sine."""
    channel = equations(noisy=False).channels[name]
    left = channel.left[channel.fitted]
    assert rms(residual(channel)) < least * left.std()
    assert channel.fitted.sum() > 1500


@pytest.mark.parametrize(
    ("name", "column", "change"),
    [
        (MOTOR, "drive_torque", 1.02),
        (MOTOR, COULOMB, 1.1 * PLAIN.coulomb),
        (MOTOR, VISCOUS, 1.1 * PLAIN.viscous),
        (MOTOR, "command_delay", 1e-3),
        (MOTOR, "torque_delay", 1e-3),
        (TRANSMISSION, "torsional_compliance", 1.01 / PLAIN.stiffness),
        (TRANSMISSION, "torsional_damping", 2e-4 / PLAIN.stiffness),
        (TRANSMISSION, "transmission_zero", 1e-6),
        (TRANSMISSION, "joint_delay", 1e-4),
        (LINK, "drive_torque", 1.002),
        (LINK, "torque_delay", 1e-4),
    ],
)
def test_no_balance_closes_with_another_value(name: str, column: str, change: float) -> None:
    channel = equations(noisy=False).channels[name]
    assert rms(residual(channel, **{column: change})) > 2.0 * rms(residual(channel))


def noise_of(channel: Channel) -> float:
    """What white noise of the sensors leaves in a balance: sqrt(2 T sum sigma^2 int |H(f)|^2 df)."""
    f = np.linspace(0.0, channel.band.zero, 4000)
    gain = Band(channel.band.flat, channel.band.zero).gain(f) ** 2
    plain, twice = (2.0 * PERIOD * float(np.trapezoid(w * gain, f)) for w in (1.0, (2.0 * np.pi * f) ** 4))
    motor, joint, gauge = NOISE["motor_shaft_position"] / RATIO, NOISE["joint_position"], NOISE["gauge_torque"]
    power = {
        MOTOR: (PLAIN.rotor_inertia * motor) ** 2 * twice + gauge**2 * plain,
        LINK: (PLAIN.link_inertia * joint) ** 2 * twice + gauge**2 * plain,
        TRANSMISSION: (motor**2 + joint**2 + (gauge / PLAIN.stiffness) ** 2) * plain,
    }
    return float(np.sqrt(power[channel.name]))


@pytest.mark.parametrize("name", [MOTOR, TRANSMISSION, LINK])
def test_what_is_left_is_the_noise_that_was_added(name: str) -> None:
    """Its RMS errs by 1 / sqrt(2 n), n = 2 * 10 s * 40 Hz independent values: 2.5 %. Rows of the rotor away from stops:
    near them the noise also moves the instant of the stop."""
    channel = equations().channels[name]
    away = np.abs(equations().states.motor_velocity[:: channel.band.step][channel.fitted]) > 0.15
    rows = away if name == MOTOR else np.ones(away.size, bool)
    assert rms(residual(channel)[rows]) == pytest.approx(noise_of(channel), rel=0.07)


def test_the_acceleration_over_its_noise_is_known() -> None:
    """Power of the true acceleration in the band over that of white position noise, twice differentiated."""
    for name, sigma, position in (
        (MOTOR, NOISE["motor_shaft_position"] / RATIO, signals(noisy=False).motor_shaft_position / RATIO),
        (LINK, NOISE["joint_position"], signals(noisy=False).joint_position),
    ):
        channel = equations().channels[name]
        f = np.linspace(0.0, channel.band.zero, 4000)
        noise = 2.0 * PERIOD * sigma**2 * np.trapezoid((2.0 * np.pi * f) ** 4 * channel.band.gain(f) ** 2, f)
        truth = channel.spectral.filter(position, channel.band, 2)[channel.valid]
        assert channel.snr == pytest.approx(np.mean(truth**2) / noise, rel=0.05)


@lru_cache(maxsize=1)
def slow() -> JointEquations:
    """Motion so slow that its acceleration is below the noise of a coarse encoder."""
    clean = simulate(seconds=40.0, tones=((0.6, 0.03), (0.4, 0.05), (0.2, 0.083)))
    noisy = with_noise(clean, {**NOISE, "motor_shaft_position": 1e-2, "joint_position": 1e-4})
    return build_equations(noisy, known(), link_of(noisy))


def test_with_little_acceleration_the_torque_stands_on_the_left() -> None:
    """a = 1 then, and the inertia is a correction with a prior: as a noisy regressor it would be lost."""
    for name, prior in ((MOTOR, 0.1), (LINK, 0.1)):
        fast, other = equations().channels[name], slow().channels[name]
        assert fast.snr > ACCELERATION_SNR > other.snr
        assert fast.scale == 0 and fast.base[0].name == "drive_torque" and fast.base[0].prior == np.inf
        assert other.scale is None
        assert (other.base[0].name, other.base[0].prior) == ("inertia_correction", prior)
        assert "drive_torque" not in [base.name for base in other.base]
    for name, inertia, angle in (
        (MOTOR, PLAIN.rotor_inertia, "motor_position"),
        (LINK, PLAIN.link_inertia, "joint_position"),
    ):
        channel = slow().channels[name]
        moved = channel.spectral.filter(slow().derived.filled[angle], channel.band, 2)
        np.testing.assert_allclose(channel.base[0].column, inertia * moved, atol=1e-9 * np.abs(moved).max())
    # I phi'' - (u - tau) + friction = 0 with the acceleration on the right, all of it the joint's own.
    channel = slow().channels[MOTOR]
    friction = {COULOMB: PLAIN.coulomb, VISCOUS: PLAIN.viscous}
    closed = channel.left - sum(friction.get(base.name, 0.0) * base.column for base in channel.base)
    quiet = channel.fitted & (np.abs(slow().states.motor_velocity[:: channel.band.step]) > 0.02)
    assert rms(closed[quiet] - closed[quiet].mean()) < 0.1 * channel.left[quiet].std()


def test_priors_and_units_are_those_of_the_data_sheet() -> None:
    recorded = signals()
    sure = build_equations(recorded, known(rotor_inertia_prior=0.02), link_of(recorded))
    assert sure.inertia == PLAIN.rotor_inertia and sure.link_scale == 1.0
    other = build_equations(recorded, replace(known(), rotor_inertia=2.0 * PLAIN.rotor_inertia), link_of(recorded))
    np.testing.assert_allclose(other.channels[MOTOR].left, 2.0 * sure.channels[MOTOR].left)
    delays = {b.name: (b.prior, b.shared) for c in sure.channels.values() for b in c.base if "delay" in b.name}
    assert delays == {"command_delay": (3e-5, False), "torque_delay": (5e-4, True), "joint_delay": (5e-4, False)}


def test_a_late_gauge_is_one_negative_delay_in_both_of_its_balances() -> None:
    """tau(t) = tau_s(t + D): with the column D the two close, with its mirror image they fail by twice as much."""
    delay, gauge = 1e-3, signals(noisy=False).gauge_torque
    late = gauge - delay * np.gradient(gauge, PERIOD) + 0.5 * delay**2 * np.gradient(np.gradient(gauge, PERIOD), PERIOD)
    recorded = replace(signals(noisy=False), gauge_torque=late)
    found = build_equations(recorded, known(), link_of(recorded))
    for name in (MOTOR, LINK):
        right, none, wrong = (rms(residual(found.channels[name], torque_delay=d)) for d in (-delay, 0.0, delay))
        assert right < 0.7 * none < 0.7 * wrong, name


@pytest.mark.parametrize("delay", [0.0, 3e-3])
def test_a_delay_that_the_model_knows_is_taken_out_of_the_command(delay: float) -> None:
    """The command of a drive that answers three samples late, with and without the model saying so."""
    samples = round(delay / PERIOD)
    command = np.concatenate([np.zeros(samples), signals(noisy=False).motor_torque])[: signals().time.size]
    # The recorded command comes earlier by the delay than what acts.
    early = np.concatenate([command[samples:], np.full(samples, command[-1])])
    recorded = replace(signals(noisy=False), motor_torque=np.concatenate([early[samples:], np.zeros(samples)]))
    knowing, silent = (build_equations(recorded, known(command_delay=d), None).channels[MOTOR] for d in (delay, 0.0))
    late = {"torque_delay": 0.0}
    assert rms(residual(knowing, **late)) < 0.02 * knowing.left.std()
    assert delay == 0.0 or rms(residual(silent, **late)) > 3.0 * rms(residual(knowing, **late))


@pytest.mark.parametrize(
    ("missing", "channels", "substituted"),
    [
        ((), {MOTOR, TRANSMISSION, LINK}, ()),
        (("motor_torque",), {TRANSMISSION, LINK}, ()),
        (("joint_position",), {MOTOR, LINK}, ()),
        (("gauge_torque",), {MOTOR, TRANSMISSION}, ("gauge_torque",)),
        (("motor_shaft_position",), {LINK}, ()),
    ],
)
def test_the_signals_decide_which_balances_there_are(
    missing: tuple[str, ...], channels: set[str], substituted: tuple[str, ...]
) -> None:
    recorded = replace(signals(), **dict.fromkeys(missing))
    found = build_equations(recorded, known(), link_of(signals()))
    assert set(found.channels) == channels and found.substituted == substituted and found.too_short == ()
    without_link = build_equations(recorded, known(), None)
    assert set(without_link.channels) == channels - {LINK} - ({MOTOR, TRANSMISSION} if substituted else set())


def test_without_a_gauge_rotor_and_link_are_one_balance() -> None:
    """-I phi'' - J q'' = -(u - g) + friction: what the gauge would read cancels.

    The acceleration of the link is known in the band of the link balance only, to 30 Hz; beyond it the command still
    has a little, at stops above all: 1 % is left elsewhere, where the balance with a gauge leaves 0.8 %.
    """
    blind = replace(signals(noisy=False), gauge_torque=None)
    channel = build_equations(blind, known(), link_of(blind)).channels[MOTOR]
    assert rms(residual(channel)) < 0.01 * channel.left[channel.fitted].std()
    both = PLAIN.rotor_inertia * np.gradient(np.gradient(blind.motor_shaft_position / RATIO, PERIOD), PERIOD)
    both += PLAIN.link_inertia * np.gradient(np.gradient(blind.joint_position, PERIOD), PERIOD)
    expected = -channel.spectral.filter(both, channel.band)
    assert rms((channel.left - expected)[100:-100]) < 0.05 * expected.std()


def test_a_noisier_encoder_narrows_the_band_of_the_rotor_balance() -> None:
    """Acceleration noise grows with the square of the frequency: the first band in which it is 200 times below."""
    zeros = []
    for factor in (0.1, 1.0, 5.0, 30.0):
        levels = {**NOISE, "motor_shaft_position": factor * NOISE["motor_shaft_position"]}
        noisy = with_noise(signals(noisy=False), levels)
        zeros.append(build_equations(noisy, known(), None).channels[MOTOR].band.zero)
    assert zeros == sorted(zeros, reverse=True) and zeros[0] == MOTOR_BANDS[0][1] and zeros[-1] == MOTOR_BANDS[-1][1]


def test_a_noisy_resolver_narrows_the_band_of_the_transmission() -> None:
    little = {name: 0.05 * level for name, level in NOISE.items()}
    for sigma, band in ((1e-7, BANDS[0]), (4e-4, BANDS[-1])):
        noisy = with_noise(signals(noisy=False), {**little, "joint_position": sigma})
        found = build_equations(noisy, known(), None).channels[TRANSMISSION].band
        assert (found.flat, found.zero) == band


def test_rows_near_gaps_rest_and_ends_are_not_valid() -> None:
    gauge = signals().gauge_torque.copy()
    gauge[12_000:12_100] = np.nan
    holes = build_equations(replace(signals(), gauge_torque=gauge), known(), link_of(signals()))
    whole = equations()
    for name, channel in holes.channels.items():
        assert channel.time.size == whole.channels[name].time.size
        near = (channel.time > 12.0 - 0.015) & (channel.time < 12.1 + 0.015)
        assert not channel.valid[near].any() and whole.channels[name].valid[near].any()
        assert (~channel.valid & whole.channels[name].valid).sum() * channel.band.step * PERIOD < 0.3
    sliding = whole.derived.sliding[:: whole.channels[MOTOR].band.step]
    assert not (whole.channels[MOTOR].valid & ~sliding).any(), "where friction builds up its law is not whole"


def test_too_few_rows_in_motion_leave_a_balance_out_by_name() -> None:
    short = signals()
    rows = slice(0, 3200)
    cut = replace(
        short, time=short.time[rows], valid=short.valid[rows],
        **{name: getattr(short, name)[rows] for name in short.present},
    )  # fmt: skip
    found = build_equations(cut, known(), link_of(cut))
    assert MOTOR in found.too_short and MOTOR not in found.channels
    for channel in found.channels.values():
        assert channel.fitted.sum() >= LEAST_ROWS


def test_the_spring_carries_what_the_damper_does_not() -> None:
    """The torque of the spring alone, tau_s / (1 + d s), is k times the torsion."""
    found = equations(noisy=False).states
    clean = signals(noisy=False)
    torsion = clean.motor_shaft_position / RATIO - clean.joint_position
    inside = slice(600, -600)
    assert found.torsional_compliance == pytest.approx(1.0 / PLAIN.stiffness, rel=1e-3)
    assert found.damping_time == pytest.approx(PLAIN.damping_time, rel=0.02)
    error = found.elastic_torque - PLAIN.stiffness * torsion
    assert rms(error[inside]) < 2e-3 * rms(PLAIN.stiffness * torsion[inside])
