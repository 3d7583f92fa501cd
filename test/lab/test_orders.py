"""Order spectrum: lines that are there are found, named and bound to angle or time; noise has none."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from plain_joint import equations

from hd_control.lab.maps.orders import (
    ANGLE,
    HERTZ,
    JOINT,
    ONE_SPEED,
    OrderLine,
    OrderRecord,
    OrderSpectrum,
    channel_record,
    describe,
    lines_of,
    local_floor,
    names_of,
    order_spectrum,
)

FloatArray = NDArray[np.float64]
PERIOD, BAND, RATIO = 0.008, 38.0, 100.0
Signal = Callable[[FloatArray, FloatArray], FloatArray]
SEEDS = int(os.environ.get("HD_COUNT", "12"))
"""Signals of each kind without a line; `hd test test/lab/test_orders.py --count 150` tries more."""


def sweep(speed: float, seconds: float = 40.0) -> tuple[FloatArray, FloatArray]:
    """Time and wave-generator turns of a joint that goes to and fro over 1.6 rad at a nearly constant speed rad/s."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    phase = time * speed / 3.2
    triangle = 2.0 * np.abs(phase - np.floor(phase + 0.5))
    return time, (1.6 * triangle + 0.005 * np.sin(0.9 * time)) * RATIO / (2.0 * np.pi)


def changing(seconds: float = 60.0) -> tuple[FloatArray, FloatArray]:
    """A joint whose speed changes between 0 and 0.28 rad/s within each pass."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return time, 1.1 * np.sin(0.25 * time) * RATIO / (2.0 * np.pi)


def record(motion: tuple[FloatArray, FloatArray], signal: Signal, noise: float = 1.0, seed: int = 0) -> OrderRecord:
    """The signal with white noise; rows near reversals are not used."""
    time, turns = motion
    values = signal(time, turns) + noise * np.random.default_rng(seed).standard_normal(time.size)
    return OrderRecord(time, turns, values, np.abs(np.gradient(turns, time)) > 0.1, BAND)


def wave(order: float, amplitude: float) -> Signal:
    """A line that is bound to the angle."""
    return lambda time, turns: amplitude * np.cos(2.0 * np.pi * order * turns + 0.4)


def found(records: list[OrderRecord], ratio: float | None = RATIO) -> tuple[OrderSpectrum, tuple[OrderLine, ...]]:
    """Spectrum and lines."""
    spectrum = order_spectrum(records, ratio)
    return spectrum, lines_of(spectrum)


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0, 6.0])
def test_a_line_is_found_at_its_order_with_its_amplitude(order: float) -> None:
    _, lines = found([record(changing(), wave(order, 1.0), noise=0.5)])
    (line,) = lines
    assert line.order == pytest.approx(order, abs=0.5 * line.resolution)
    assert line.amplitude == pytest.approx(1.0, rel=0.1)
    assert line.directions == (-1, 1)
    assert line.names[0].startswith(f"{order:.0f} per wave-generator turn")


def test_a_line_that_keeps_its_order_is_bound_to_the_angle() -> None:
    records = [record(sweep(speed), wave(2.0, 0.8), noise=0.5, seed=i) for i, speed in enumerate((0.2, 0.35))]
    _, lines = found(records)
    assert [(round(line.order), line.bound) for line in lines] == [(2, ANGLE)]


def test_a_tone_in_time_is_no_property_of_the_angle() -> None:
    """9 Hz at two speeds: two orders, none of them named."""

    def tone(time: FloatArray, turns: FloatArray) -> FloatArray:
        return 0.8 * np.cos(2.0 * np.pi * 9.0 * time)

    records = [record(sweep(speed), tone, noise=0.3, seed=i) for i, speed in enumerate((0.2, 0.3))]
    _, lines = found(records)
    assert lines and {line.bound for line in lines} == {HERTZ}
    assert all(line.names == () for line in lines)


def test_at_one_speed_angle_and_time_are_not_separable() -> None:
    spectrum, lines = found([record(sweep(0.2), wave(2.0, 0.8), noise=0.5)])
    assert [line.bound for line in lines] == [ONE_SPEED]
    assert "one speed only" in describe(lines[0], spectrum, "N m")


def test_directions_stay_apart() -> None:
    def forward_only(time: FloatArray, turns: FloatArray) -> FloatArray:
        return np.where(np.gradient(turns, time) > 0.0, 1.0, 0.0) * wave(2.0, 1.0)(time, turns)

    _, lines = found([record(changing(), forward_only, noise=0.5)])
    assert [line.directions for line in lines] == [(1,)]


def coloured(kind: str, seed: int) -> Signal:
    """Residuals without a line: white, slowly changing, a random walk, friction over gravity."""
    from scipy.signal import lfilter

    def values(time: FloatArray, turns: FloatArray) -> FloatArray:
        white = np.random.default_rng(1000 + seed).standard_normal(time.size)
        speed = np.gradient(turns, time)
        friction = np.sign(speed) * (1.0 + np.exp(-np.abs(speed))) + 3.0 * np.sin(turns / 16.0)
        return {
            "white": white,
            "slow": np.asarray(lfilter([1.0], [1.0, -0.97], white)),
            "walk": np.cumsum(white),
            "friction": 0.02 * white + friction,
        }[kind]

    return values


@pytest.mark.parametrize("kind", ["white", "slow", "walk", "friction"])
def test_no_line_where_there_is_none(kind: str) -> None:
    motions = [changing(), sweep(0.2), sweep(0.5)]
    for seed in range(SEEDS):
        noise = record(motions[seed % 3], coloured(kind, seed), noise=0.01)
        spectrum, lines = found([noise])
        assert spectrum.range[1] > 2.0 and lines == ()


def test_neighbours_are_separable_only_with_enough_turns() -> None:
    """2 N and 2 (N + 1) per joint turn: half a joint turn separates them, less lists both."""
    assert len(names_of(2.0, 1.0 / 60.0, RATIO)) == 1
    assert len(names_of(2.0, 1.0 / 30.0, RATIO)) == 3
    assert names_of(2.0 * 101.0 / 100.0, 1.0 / 60.0, RATIO)[0].startswith("2(N+1) = 202")
    assert names_of(3.4, 0.5, RATIO) == ()


def test_without_a_gear_ratio_the_joint_counts_and_the_ratio_is_a_guess() -> None:
    time, turns = sweep(0.2)
    joint = OrderRecord(
        *(record((time, turns), wave(2.0, 0.8), noise=0.5).__dict__ | {"turns": turns / RATIO}).values()
    )
    spectrum = order_spectrum([joint], None, 20.0, 1000.0)
    (line,) = lines_of(spectrum)
    assert spectrum.turn == JOINT and line.order == pytest.approx(200.0, abs=line.resolution)
    low, high = (float(word) for word in line.names[0].rsplit(" is ", 1)[1].split(" to "))
    assert low <= 100.0 <= high


def test_orders_beyond_the_band_are_not_judged() -> None:
    """At 0.5 rad/s order 6 is 48 Hz: outside the band of 38 Hz."""
    spectrum, lines = found([record(sweep(0.5), wave(6.0, 5.0), noise=0.5)])
    assert spectrum.range[1] < 6.0 and lines == ()
    spectrum, lines = found([record(sweep(0.2), wave(6.0, 5.0), noise=0.5)])
    assert [round(line.order) for line in lines] == [6]


def test_nothing_moves_nothing_is_said() -> None:
    time = np.arange(2000) * PERIOD
    still = OrderRecord(time, np.zeros(2000), np.ones(2000), np.ones(2000, dtype=bool), BAND)
    spectrum = order_spectrum([still], RATIO)
    assert spectrum.parts == () and lines_of(spectrum) == () and np.isnan(spectrum.range[0])


def test_the_floor_is_a_median_of_both_sides() -> None:
    slope = np.linspace(10.0, 1.0, 400)
    floor = local_floor(slope, 2)
    inside = np.isfinite(floor)
    assert (floor[inside] >= slope[inside]).all() and not inside[:10].any() and not inside[-10:].any()


@pytest.mark.parametrize("order", [1.3, 2.0, 2.51, 5.77])
@pytest.mark.parametrize("amplitude", [0.3, 3.0])
def test_order_and_amplitude_of_a_sine_between_the_bins(order: float, amplitude: float) -> None:
    """A Hann window padded twice: the parabola over three logarithms is right within 0.7 % of the amplitude and a tenth
    of the resolution, wherever the line lies; without it a line between two bins would be 1.5 % too low."""
    _, (line, *_) = found([record(changing(), wave(order, amplitude), noise=0.01 * amplitude)])
    assert line.order == pytest.approx(order, abs=0.1 * line.resolution)
    assert line.amplitude == pytest.approx(amplitude, rel=0.007)


def test_lines_apart_by_three_cells_are_two() -> None:
    """Resolution is one over the turns of a stretch."""
    _, (line, *_) = found([record(changing(), wave(2.0, 1.0), noise=0.05)])
    gap = 4.0 * line.resolution

    def both(time: FloatArray, turns: FloatArray) -> FloatArray:
        return wave(2.0, 1.0)(time, turns) + wave(2.0 + gap, 1.0)(time, turns)

    _, lines = found([record(changing(), both, noise=0.05)])
    assert sorted(x.order for x in lines[:2]) == pytest.approx([2.0, 2.0 + gap], abs=0.3 * line.resolution)


def test_the_local_floor_is_the_larger_of_two_medians_by_hand() -> None:
    random = np.random.default_rng(2)
    amplitude, cell = random.exponential(1.0, 200), 2
    found_floor = local_floor(amplitude, cell)
    width, guard, least = 12 * cell, 2 * cell, 5 * cell
    for k in range(200):
        left = amplitude[max(0, k - guard - width) : max(0, k - guard)]
        right = amplitude[k + guard + 1 : k + guard + 1 + width]
        if min(left.size, right.size) < least:
            assert np.isnan(found_floor[k])
        else:
            assert found_floor[k] == pytest.approx(max(np.median(left), np.median(right)))
    assert np.isnan(local_floor(np.array([1.0, np.nan, 1.0] * 100), 2)).all()


def test_several_records_of_one_signal_are_averaged_in_power() -> None:
    """Amplitudes 1 and 0 in two equal records: the RMS over both, 1 / sqrt(2)."""
    loud, still = (record(changing(), wave(2.0, size), noise=0.02) for size in (1.0, 1e-6))
    _, (line,) = found([loud, still])
    assert line.amplitude == pytest.approx(np.sqrt(0.5), rel=0.03)


def test_the_record_of_a_channel_counts_turns_of_the_wave_generator() -> None:
    there = equations()
    channel = there.channels["transmission"]
    made = channel_record(there, "transmission", channel.left, channel.fitted)
    shaft = there.states.motor_shaft_position[:: channel.band.step]
    np.testing.assert_allclose(2.0 * np.pi * made.turns, shaft)
    assert made.band == channel.band.flat and made.values is channel.left and made.time is channel.time
