"""Noise floors from the sensors alone against noise that is sent through the balances itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import NOISE, PERIOD, RATIO
from plain_joint import PLAIN, equations, known, signals
from scipy.signal import butter, sosfiltfilt

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.balances.floors import link_inertia, sensor_floor, smoothed_floor
from hd_control.lab.signals.sensors import SensorQuality, sensor_qualities


def known_qualities() -> dict[str, SensorQuality]:
    """What `with_noise` adds, as qualities."""
    units = {"motor_shaft_position": "rad", "joint_position": "rad", "gauge_torque": "N m"}
    return {
        name: SensorQuality(name, units[name], 0.0, level, 2.0 * level**2 * PERIOD, np.inf, 0.0, 1.0 / PERIOD)
        for name, level in NOISE.items()
    }


def through_the_balance(found: JointEquations, name: str) -> float:
    """RMS of white noise of the sensors, filtered and differentiated as the balance filters its terms."""
    random, channel = np.random.default_rng(5), found.channels[name]
    n = found.states.time.size
    noise = {signal: level * random.standard_normal(n) for signal, level in NOISE.items()}
    sp, band = found.spectral, channel.band
    motor, joint, gauge = noise["motor_shaft_position"] / RATIO, noise["joint_position"], noise["gauge_torque"]
    rows = {
        MOTOR: lambda: found.inertia * sp.filter(motor, band, 2) + sp.filter(gauge, band),
        LINK: lambda: PLAIN.link_inertia * sp.filter(joint, band, 2) + sp.filter(gauge, band),
        TRANSMISSION: lambda: sp.filter(joint - motor + gauge / PLAIN.stiffness, band),
    }[name]()
    return float(rows.std())


@pytest.mark.parametrize("name", [MOTOR, LINK, TRANSMISSION])
def test_the_floor_is_the_noise_that_the_balance_lets_through(name: str) -> None:
    found = equations()
    floor = sensor_floor(found, name, known_qualities())
    assert floor == pytest.approx(through_the_balance(found, name), rel=0.05)


@pytest.mark.parametrize("name", [MOTOR, LINK, TRANSMISSION])
def test_measured_sensors_give_the_same_floor(name: str) -> None:
    recorded = signals()
    measured = {k: v for k, v in sensor_qualities(recorded).items() if k != "motor_torque"}
    assert sensor_floor(equations(), name, measured) == pytest.approx(
        sensor_floor(equations(), name, known_qualities()), rel=0.1
    )


def test_a_sensor_that_is_not_there_adds_nothing() -> None:
    assert sensor_floor(equations(), LINK, {}) == 0.0
    only = {"gauge_torque": known_qualities()["gauge_torque"]}
    assert 0.0 < sensor_floor(equations(), LINK, only) < sensor_floor(equations(), LINK, known_qualities())


def test_a_torque_that_is_held_or_averaged_has_less_noise_in_the_balance() -> None:
    quality = SensorQuality("motor_torque", "N m", 0.0, 1.0, 2e-3, np.inf, 0.0, 1000.0)
    at_100 = replace(quality, density=2e-2, rate=100.0)
    held = sensor_floor(equations(), MOTOR, {"motor_torque": quality})
    slow = sensor_floor(equations(), MOTOR, {"motor_torque": at_100})
    averaged = sensor_floor(equations(), MOTOR, {"motor_torque": replace(at_100, averaged=True)})
    assert averaged < slow < np.sqrt(10.0) * held


def test_the_inertia_of_the_link_is_what_its_torque_shows() -> None:
    assert link_inertia(equations()) == pytest.approx(PLAIN.link_inertia, rel=0.02)
    bare = build_equations(signals(), known(), None)
    assert link_inertia(bare) == 0.0


def test_below_a_cut_off_the_floor_is_what_a_model_leaves() -> None:
    """White noise of 0.2 N m per row, smoothed at 8 Hz: its RMS is found within a third, though nothing is above."""
    channel = equations().channels[LINK]
    rate = 1.0 / (channel.band.step * PERIOD)
    random = np.random.default_rng(2)
    rows = sosfiltfilt(butter(2, 8.0, fs=rate, output="sos"), 0.2 * random.standard_normal(channel.time.size))
    smoothed = {"gauge_torque": SensorQuality("gauge_torque", "N m", 0.0, np.nan, np.nan, 8.0, 0.0, 1000.0)}
    assert smoothed_floor(channel, rows, smoothed) == pytest.approx(rows.std(), rel=0.35)
    assert smoothed_floor(channel, rows, known_qualities()) == 0.0
    assert smoothed_floor(channel, rows, {}) == 0.0
