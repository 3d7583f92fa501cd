"""Condition maps: shares, means and the sentence on residuals whose place is known by construction."""

from __future__ import annotations

import numpy as np
import pytest
from plain_joint import equations

from hd_control.lab.maps.condition_maps import (
    Conditions,
    Range,
    bin_edges,
    concentration,
    conditions_of,
    correlation_time,
    maps_of,
    place,
    sentence,
    worst,
)

ROWS, PERIOD = 7500, 0.008


def conditions(seed: int = 0) -> Conditions:
    """A joint that moves to and fro at changing speed under a load that has nothing to do with the motion."""
    time = np.arange(ROWS) * PERIOD
    phase = 2.0 * np.pi * (0.2 * time + 0.004 * time**2)
    position, velocity = 0.8 * np.sin(phase), np.cos(phase) * (0.3 + 0.01 * time)
    turned = np.flatnonzero(np.diff(np.sign(velocity)))
    last = np.concatenate([[0], turned])[np.searchsorted(turned, np.arange(ROWS), side="left")]
    return Conditions(
        np.sign(velocity),
        {
            "motor_velocity": np.abs(velocity),
            "joint_torque": 20.0 * np.sin(2.0 * np.pi * 0.0713 * time + 1.0),
            "motor_shaft_position": np.mod(100.0 * position, 2.0 * np.pi),
            "joint_position": position,
            "direction": np.sign(velocity),
            "reversal_time": (np.arange(ROWS) - last) * PERIOD,
            "time": time,
        },
    )


def noise(seed: int = 0) -> np.ndarray:
    """White noise (ROWS,) with unit variance."""
    return np.random.default_rng(seed).standard_normal(ROWS)


EVERYWHERE = np.ones(ROWS, dtype=bool)


def test_shares_of_every_map_add_up_to_one_and_empty_bins_stay_empty() -> None:
    maps = maps_of(conditions(), noise(), EVERYWHERE)
    assert maps.speed_load is not None
    for item in (*maps.maps.values(), maps.speed_load):
        assert item.bins.share.sum() == pytest.approx(1.0)
        assert item.bins.count.sum() == ROWS
        empty = item.bins.count == 0
        np.testing.assert_array_equal(np.isnan(item.bins.mean), empty)
        np.testing.assert_array_equal(np.isnan(item.bins.rms), empty)
        assert (item.bins.share[empty] == 0.0).all()
    assert (maps.maps["motor_shaft_position"].edges.size, maps.maps["direction"].bins.count.shape) == (73, (3, 3))
    assert np.isnan(maps.maps["time"].bins.mean[1]).all(), "the joint never rests"


def test_rms_and_shares_agree_with_the_residual() -> None:
    residual, used = noise(), noise(1) > 0.3
    maps = maps_of(conditions(), residual, used)
    assert maps.rms == pytest.approx(np.sqrt(np.mean(residual[used] ** 2)))
    for item in maps.maps.values():
        square = np.nansum(item.bins.count * item.bins.rms**2)
        assert np.sqrt(square / used.sum()) == pytest.approx(maps.rms)


def test_friction_shows_as_means_of_opposite_sign() -> None:
    there = conditions()
    item = maps_of(there, 2.0 * there.direction + 0.1 * noise(), EVERYWHERE).maps["direction"]
    assert item.bins.mean[0, 0] == pytest.approx(-2.0, abs=0.01)
    assert item.bins.mean[2, 2] == pytest.approx(2.0, abs=0.01)
    assert item.explained == pytest.approx(4.0 / 4.01, abs=1e-3)


def test_noise_depends_on_nothing() -> None:
    for seed in range(20):
        maps = maps_of(conditions(), noise(seed), EVERYWHERE)
        assert max(item.explained for item in maps.maps.values()) < 0.02
        assert sentence(maps) == "The error is spread evenly over speed, load, angle and time."


def test_explained_share_is_that_of_the_true_curve() -> None:
    there = conditions()
    wave = np.sqrt(2.0) * np.sin(2.0 * there.variables["motor_shaft_position"])
    maps = maps_of(there, wave + noise(), EVERYWHERE)
    assert maps.maps["motor_shaft_position"].explained == pytest.approx(0.5, abs=0.03)
    assert max(item.explained for name, item in maps.maps.items() if name != "motor_shaft_position") < 0.1
    assert sentence(maps).startswith("The mean over motor angle explains")


def test_the_sentence_finds_the_reversals() -> None:
    there = conditions()
    near = there.variables["reversal_time"] < 0.05
    residual = noise() * np.where(near, 8.0, 1.0)
    maps = maps_of(there, residual, EVERYWHERE)
    share = (residual[near] ** 2).sum() / (residual**2).sum()
    found = concentration(maps)
    assert found is not None and found.variable == "reversal_time" and found.from_start
    assert found.high == pytest.approx(0.05, rel=0.4) and found.share == pytest.approx(share, abs=0.05)
    assert "ms after a reversal" in sentence(maps)


def test_worst_bins_carry_sign_and_rms() -> None:
    there = conditions()
    backward_fast = (there.direction < 0) & (there.variables["motor_velocity"] > 0.5)
    residual = noise() * np.where(backward_fast, 5.0, 1.0)
    found = worst(maps_of(there, residual, EVERYWHERE))
    assert [item["share_of_error"] for item in found] == sorted((i["share_of_error"] for i in found), reverse=True)
    speeds = [item for item in found if item["variable"] == "motor_velocity"]
    assert speeds and all(item["high"] < 0.0 and item["low"] < -0.5 for item in speeds)
    assert speeds[0]["rms_error"] == pytest.approx(5.0, rel=0.15)
    assert set(found[0]) == {"variable", "low", "high", "share_of_error", "rms_error"}


def test_slow_residuals_have_few_independent_samples() -> None:
    maps = maps_of(conditions(), noise(), EVERYWHERE)
    assert not maps.maps["joint_torque"].bins.few.any()
    slow = np.convolve(noise(), np.ones(200) / 200.0, "same")
    assert maps_of(conditions(), slow, EVERYWHERE).maps["joint_torque"].bins.few.any()


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.98])
def test_correlation_time_of_an_autoregression(memory: float) -> None:
    """1 + 2 sum memory^k = (1 + memory) / (1 - memory), also where half of the rows are not used."""
    from scipy.signal import lfilter

    series = lfilter([1.0], [1.0, -memory], np.random.default_rng(3).standard_normal(60_000))
    used = (np.arange(series.size) // 3000) % 2 == 0
    expected = (1.0 + memory) / (1.0 - memory)
    for rows in (np.ones(series.size, dtype=bool), used):
        assert correlation_time(np.where(rows, series, 0.0), rows) == pytest.approx(expected, rel=0.25)


def test_at_the_floor_nothing_is_said_and_without_rows_nothing_is_known() -> None:
    maps = maps_of(conditions(), noise(), EVERYWHERE)
    assert sentence(maps, 1.0).startswith("The error is at the noise floor")
    nothing = maps_of(conditions(), noise(), ~EVERYWHERE)
    assert sentence(nothing) == "There are no rows to judge." and worst(nothing) == []


def test_edges_follow_the_kind_of_the_variable() -> None:
    random = np.random.default_rng(0)
    speed = np.abs(random.standard_normal(5000)) + 1e-3
    edges = bin_edges("motor_velocity", speed)
    ratios = edges[2:] / edges[1:-1]
    np.testing.assert_allclose(ratios, ratios[0])
    assert edges[-1] == pytest.approx(speed.max())
    assert edges[0] == 0.0, "what is slower than the 2 % quantile has a bin of its own"
    load = np.concatenate([np.zeros(4000), random.standard_normal(1000)])
    assert (np.diff(bin_edges("joint_torque", load)) > 0.0).all(), "equal quantiles are one edge"
    even = bin_edges("joint_torque", random.standard_normal(10_000))
    counts = np.histogram(np.random.default_rng(0).standard_normal(10_000), even)[0]
    assert even.size == 11 and counts.min() > 0
    assert bin_edges("motor_shaft_position", load).size == 73 and bin_edges("direction", load).size == 4
    np.testing.assert_allclose(np.diff(bin_edges("time", np.array([1.0, 4.0]))), 0.1)
    assert bin_edges("temperature", np.full(10, 25.0)).size == 0, "it does not vary"


def test_a_value_on_an_edge_belongs_to_the_bin_above_and_the_last_one_to_the_last() -> None:
    edges = bin_edges("time", np.array([0.0, 3.0]))
    there = Conditions(np.ones(4), {"time": edges[[0, 1, 5, -1]]})
    counts = maps_of(there, np.arange(1.0, 5.0), np.ones(4, bool)).maps["time"].bins.count
    assert np.flatnonzero(counts[2]).tolist() == [0, 1, 5, edges.size - 2] and counts.sum() == 4.0


@pytest.mark.parametrize(
    ("variable", "low", "high", "start", "end", "words"),
    [
        ("reversal_time", 0.0, 0.01, True, False, "within 10 ms after a reversal"),
        ("reversal_time", 1.5, 3.0, False, True, "more than 1.5 s after a reversal"),
        ("reversal_time", 0.1, 0.2, False, False, "from 100 to 200 ms after a reversal"),
        ("reversal_travel", 0.0, 2e-3, True, False, "within 2 mrad after a reversal"),
        ("reversal_travel", 5e-3, 0.2, False, True, "more than 5 mrad after a reversal"),
        ("joint_position", 0.0, np.pi / 2.0, False, False, "at joint angles from 0 to 90 degrees"),
        ("time", 1.0, 2.5, True, False, "between 1.0 and 2.5 s"),
        ("motor_velocity", 0.0, 0.1, True, False, "at motor speeds below 0.1 rad/s"),
        ("joint_torque", 5.0, 9.0, False, True, "at joint torques above 5 N m"),
        ("temperature", 20.0, 30.0, False, False, "at temperatures from 20 to 30 degrees Celsius"),
    ],
)
def test_a_range_in_words(variable: str, low: float, high: float, start: bool, end: bool, words: str) -> None:
    assert place(Range(variable, low, high, 0.5, 0.1, 0.3, start, end)) == words


def test_conditions_of_a_joint_are_its_states_at_the_rows_of_the_channel() -> None:
    there = equations()
    for name, speed in (("motor_torque", "motor_velocity"), ("link_torque", "joint_velocity")):
        found, step = conditions_of(there, name), there.channels[name].band.step
        np.testing.assert_array_equal(found.variables[speed], np.abs(getattr(there.states, speed))[::step])
        np.testing.assert_array_equal(found.direction, there.derived.direction[::step])
        assert "temperature" not in found.variables, "it was not recorded"
        angle = found.variables["motor_shaft_position"]
        assert angle.min() >= 0.0 and angle.max() < 2.0 * np.pi
        assert {"joint_velocity", "motor_velocity"} & set(found.variables) == {speed}


def test_friction_splits_by_direction_and_load_does_not() -> None:
    """The same mean over the load, once with the sign of the direction, once without."""
    there = conditions()
    wave = there.variables["joint_position"]
    for residual, split in ((wave * there.direction, True), (wave, False)):
        text = sentence(maps_of(there, residual + 0.1 * noise(), EVERYWHERE))
        assert ("split by direction" in text) == split, text
