"""Lines of measured torques and of the torsion: amplitudes that are known, whatever the model guesses."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from plain_joint import NAME, equations, known, signals
from scipy.signal import lfilter

from hd_control.lab.balances.channels import JointEquations, Known
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.maps.orders import OrderRecord, lines_of, order_spectra, order_spectrum
from hd_control.lab.maps.signal_spectra import (
    CLEAR,
    density_of,
    hertz_lines,
    hertz_words,
    local_floor_of,
    prevailing,
    signal_spectra,
)
from hd_control.lab.signals.joint_signals import JointSignals

RATE, RATIO, LINE = 200.0, 160.0, 0.02


def recorded(speed: float = 0.1, amplitude: float = LINE, seconds: float = 120.0) -> JointSignals:
    """To and fro at one speed: friction, inertia, a line at twice the wave generator's turns, noise of 0.01 N m."""
    time = np.arange(round(seconds * RATE)) / RATE
    stroke = round(15.0 * RATE)
    v = speed * np.where(np.arange(time.size) // stroke % 2, -1.0, 1.0)
    smooth = np.hanning(round(0.25 * RATE))
    v = np.convolve(v, smooth / smooth.sum(), "same")
    q = np.cumsum(v) / RATE
    random = np.random.default_rng(4)
    torque = 1.1 * np.sign(v) + 0.3 * np.gradient(v, time) + amplitude * np.sin(2.0 * RATIO * q + 0.4)
    torque = torque + 0.01 * random.standard_normal(time.size)
    angle = q + 1e-7 * random.standard_normal(time.size)
    return JointSignals(NAME, time, 1.0 / RATE, np.ones(time.size, bool), joint_position=angle, gauge_torque=torque)


def balances(recording: JointSignals, ratio: float = RATIO, inertia: float = 1.0) -> JointEquations:
    return build_equations(recording, Known(ratio, inertia), None)


@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_a_line_of_the_torque_has_its_own_amplitude(speed: float) -> None:
    (found,) = signal_spectra(balances(recorded(speed)))
    assert (found.signal, found.unit) == ("gauge_torque", "N m")
    line = found.lines[0]
    assert line.order == pytest.approx(2.0, abs=0.02) and any("kinematic error" in name for name in line.names)
    assert line.amplitude == pytest.approx(LINE, rel=0.1)


def test_the_amplitude_does_not_follow_a_guess() -> None:
    amplitudes = [signal_spectra(balances(recorded(), inertia=x))[0].lines[0].amplitude for x in (0.01, 1.0, 100.0)]
    np.testing.assert_allclose(amplitudes, amplitudes[0], rtol=1e-9)


def test_without_a_gear_ratio_orders_count_joint_turns() -> None:
    (found,) = signal_spectra(balances(recorded(), ratio=1.0))
    assert found.lines[0].order == pytest.approx(320.0, abs=2.0)
    assert found.json()["order_lines"][0]["per"] == "joint turn"


def test_all_measured_signals_have_their_spectra_and_the_torsion() -> None:
    found = signal_spectra(equations())
    assert [item.signal for item in found] == ["motor_torque", "gauge_torque", "torsion"]
    assert [item.unit for item in found] == ["N m", "N m", "rad"]
    bare = replace(signals(), joint_position=None, motor_torque=None)
    assert [item.signal for item in signal_spectra(build_equations(bare, known(), None))] == ["gauge_torque"]


def test_spectra_together_are_those_alone() -> None:
    random = np.random.default_rng(0)
    time = np.arange(6000) / 100.0
    turns = 2.0 * time + 0.3 * np.sin(0.2 * time)
    values = np.column_stack([np.sin(2.0 * np.pi * 2.0 * turns), np.cos(2.0 * np.pi * 4.0 * turns)])
    values = values + 0.1 * random.standard_normal(values.shape)
    used = np.ones(time.size, bool)
    together = order_spectra([OrderRecord(time, turns, values, used, 40.0)], 100.0)
    for i, both in enumerate(together):
        alone = order_spectrum([OrderRecord(time, turns, values[:, i], used, 40.0)], 100.0)
        for direction, one in alone.directions.items():
            np.testing.assert_allclose(both.directions[direction].amplitude, one.amplitude, rtol=1e-9)
    assert [lines_of(x)[0].order for x in together] == pytest.approx([2.0, 4.0], abs=0.05)


def noise_and(extra: np.ndarray, level: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, density and floor of white noise with something added, 60 s at 300 Hz."""
    random = np.random.default_rng(7)
    rows = level * random.standard_normal(18_000) + extra
    frequency, density = density_of(rows, 1.0 / 300.0, 100.0)
    return frequency, density, local_floor_of(frequency, density)


def test_a_tone_and_a_resonance_over_time() -> None:
    """A sine of 0.05; noise through a mode at 24 Hz with 3 % damping, whose power is known from its own series."""
    time = np.arange(18_000) / 300.0
    random = np.random.default_rng(3)
    omega, zeta, mode, rate, push = 2.0 * np.pi * 24.0, 0.03, 0.0, 0.0, random.standard_normal(18_000)
    ring = np.zeros(time.size)
    for k in range(1, time.size):
        for _ in range(4):
            rate += (push[k] - 2.0 * zeta * omega * rate - omega**2 * mode) / 1200.0
            mode += rate / 1200.0
        ring[k] = mode
    ring *= 0.1 / ring.std()
    lines = hertz_lines(*noise_and(0.05 * np.sin(2.0 * np.pi * 50.0 * time) + ring))
    by_frequency = sorted(lines, key=lambda x: x.frequency)
    resonance, tone = by_frequency[0], by_frequency[-1]
    assert len(lines) == 2
    assert tone.frequency == pytest.approx(50.0, abs=0.1) and tone.amplitude == pytest.approx(0.05, rel=0.1)
    assert resonance.frequency == pytest.approx(24.0, abs=0.7)
    assert resonance.amplitude == pytest.approx(np.sqrt(2.0) * 0.1, rel=0.2)
    assert resonance.width > 2.0 * tone.width
    assert "a resonance or disturbance" in hertz_words(lines, "N m")[0]


def test_noise_slopes_and_knees_are_no_lines() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        white = random.standard_normal(18_000)
        walk = np.cumsum(white) * 0.05
        for rows in (white, walk, lfilter([0.3], [1.0, -0.7], white)):
            frequency, density = density_of(rows, 1.0 / 300.0, 100.0)
            assert hertz_lines(frequency, density, local_floor_of(frequency, density)) == ()
    assert CLEAR > 4.0
    assert hertz_lines(np.zeros(0), np.zeros(0), np.zeros(0)) == ()
    assert density_of(white[:20], 1.0 / 300.0, 100.0)[0].size == 0


def test_an_order_at_one_speed_is_no_resonance() -> None:
    time = np.arange(18_000) / 300.0
    found = hertz_lines(*noise_and(0.05 * np.sin(2.0 * np.pi * 30.0 * time)), pace=7.5)
    assert [line.order for line in found] == [4.0]
    assert "order 4 at the speed that prevails" in hertz_words(found, "N m")[0]
    assert prevailing(np.where(np.arange(1000) % 2, 7.5, -7.5)) == 7.5
    assert prevailing(np.linspace(-8.0, 8.0, 1000)) is None and prevailing(np.zeros(0)) is None


def test_the_json_is_plain_and_the_sentences_carry_the_unit() -> None:
    (found,) = signal_spectra(balances(recorded()))
    document = found.json()
    assert json.loads(json.dumps(document)) == document
    line = document["order_lines"][0]
    assert line["order_per_joint_turn"] == pytest.approx(320.0, abs=3.0)
    assert line["amplitude"] == found.lines[0].amplitude
    assert "mN m" in found.sentences("mN m", 1e3)[0]
