"""Stamps of a bag: repeated, going back, jumping, scattering; temperatures of one joint among several."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_bags import NS, motion, standard_bag, ticks

from hd_control.lab.signals.recording import read_recording
from hd_control.lab.signals.time_base import one_clock, rising


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
    assert any("1000 of 3000 samples are of another clock" in text for text in recording.problems)
    assert recording.joints["joint_1"].time.size == 2000


def test_two_recordings_in_one_file_are_not_sorted_into_each_other(tmp_path: Path) -> None:
    """Both begin at the same stamp; the second one holds another motion."""
    one, two = ticks(2.0), ticks(3.0)
    time = np.concatenate([one, two]) * 1e-9
    angle = np.where(np.arange(5000) < 2000, 7.0, motion(time - 5.0)["joint_position"])
    bag = standard_bag(
        tmp_path / "bag", np.concatenate([one, two]), skip=["temperature"], change={"joint_position": angle}
    )
    recording = read_recording(bag)
    joint = recording.joints["joint_1"]
    assert joint.time.size == 3000 and joint.valid.all()
    assert np.abs(joint.joint_position - motion(joint.time)["joint_position"]).max() < 1e-8
    assert any("two recordings in one file?" in text and "3000 samples" in text for text in recording.problems)


def test_one_clock_is_cut_where_it_goes_back_and_stays() -> None:
    second = NS // 1000 * np.arange(1000)
    assert one_clock(second) == slice(0, 1000)
    stray = second.copy()
    stray[[300, 301]] -= NS
    assert one_clock(stray) == slice(0, 1000), "two stray stamps are no other clock"
    assert one_clock(np.concatenate([second, second[:600]])) == slice(0, 1000)
    assert one_clock(np.concatenate([second[:400], second, second[:600]])) == slice(400, 1400)
    swapped = second.copy()
    swapped[100:200] = second[100:200][::-1]
    assert one_clock(swapped) == slice(0, 1000), "an order that got lost over 0.1 s"
    assert one_clock(np.zeros(0, np.int64)) == slice(0, 0) and one_clock(np.array([5])) == slice(0, 1)


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
