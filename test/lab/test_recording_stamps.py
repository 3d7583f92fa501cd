"""Stamps of a bag: repeated, going back, jumping, scattering; temperatures of one joint among several."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_bags import NS, motion, standard_bag, ticks

from hd_control.lab.signals.recording import read_recording
from hd_control.lab.signals.time_base import rising


def test_stamps_that_repeat_or_go_back_are_dropped_and_reported(tmp_path: Path) -> None:
    stamps = ticks(2.0).copy()
    stamps[700], stamps[1200] = stamps[699], stamps[100]
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature"]))
    assert any("2 of 2000 samples dropped" in text for text in recording.problems)
    joint = recording.joints["joint_1"]
    assert joint.valid.all(), "single samples are bridged"
    assert np.abs(joint.joint_position - motion(joint.time)["joint_position"]).max() < 1e-8


def test_a_clock_that_starts_anew_keeps_the_longer_part(tmp_path: Path) -> None:
    stamps = np.concatenate([ticks(1.0, start_ns=100 * NS), ticks(2.0, start_ns=0)])
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature"]))
    assert any("1000 of 3000 samples dropped" in text for text in recording.problems)
    assert recording.joints["joint_1"].time.size == 2000


def test_a_clock_that_jumps_by_years_does_not_fill_the_memory(tmp_path: Path) -> None:
    stamps = np.concatenate([ticks(0.5, start_ns=0), ticks(2.0, start_ns=1_700_000_000 * NS)])
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature"]))
    assert recording.joints["joint_1"].time.size == 2000
    assert any("the clock jumped" in text for text in recording.problems)


def test_the_longest_rising_part() -> None:
    assert rising(np.array([1, 2, 3])).tolist() == [0, 1, 2]
    assert rising(np.array([5, 1, 2, 2, 3, 9, 4])).tolist() in ([1, 2, 4, 6], [1, 3, 4, 6])
    assert rising(np.array([], dtype=np.int64)).size == 0


def test_scattering_stamps_are_resampled(tmp_path: Path, rng: np.random.Generator) -> None:
    stamps = ticks(4.0, 5e-3) + rng.integers(-1_000_000, 1_000_000, 800)
    stamps[0], stamps[-1] = ticks(4.0, 5e-3)[[0, -1]]
    recording = read_recording(standard_bag(tmp_path / "bag", stamps, skip=["temperature"]))
    joint = recording.joints["joint_1"]
    assert any("scatter" in note for note in recording.notes)
    assert joint.period == pytest.approx(5e-3, rel=1e-3) and joint.valid.all()
    error = joint.joint_position - motion(joint.time)["joint_position"]
    assert np.abs(error[5:-5]).max() < 2e-5
    # The held torque of a tick is the mean of what was held during it: at most one sample old.
    held = joint.motor_torque - motion(joint.time)["motor_torque"]
    slope = np.abs(np.gradient(motion(joint.time)["motor_torque"], joint.period)).max()
    assert np.abs(held[5:-5]).max() < 1.5 * slope * joint.period


def test_one_joint_of_several_keeps_its_own_temperatures(tmp_path: Path) -> None:
    """Temperatures come one message per joint with equal stamps; those of the other joints are not repeats."""
    path = standard_bag(tmp_path / "bag", ticks(4.0), ("joint_1", "joint_2", "joint_3"))
    recording = read_recording(path, joints=["joint_2"])
    assert recording.problems == () and recording.joints["joint_2"].notes == ()
    whole = read_recording(path).joints["joint_2"].temperature
    assert whole is not None and np.array_equal(recording.joints["joint_2"].temperature, whole, equal_nan=True)
