"""Recordings of the challenge as bags and of arms: columns come back, nothing hidden is inside, arms follow."""

import numpy as np
import pytest

from hd_control.record.reader import BagReader
from hd_sim.hidden_effects import VOCABULARY
from hd_sim.puzzles.arm_recordings import draw_arm_effects, make_arm_pair
from hd_sim.puzzles.draw import chosen_case
from hd_sim.puzzles.recordings import record_pair, write_bag
from hd_sim.truth import HiddenEffect


@pytest.fixture(scope="module")
def pair():
    return record_pair(chosen_case(4, {"motor_cogging": 2.0}, "short"))


def test_columns_come_back_from_the_bag(pair, tmp_path):
    write_bag(tmp_path / "bag", ["joint_1"], pair.fit, pair.model["robot"], pair.period, {"clock": "lockstep"})
    reader = BagReader(tmp_path / "bag")
    for topic, field, name in (
        ("encoder", "position", "motor_shaft_position"),
        ("resolver", "position", "joint_position"),
        ("gauge_bridge", "effort", "gauge_torque"),
        ("motor_torque_applied", "effort", "motor_torque"),
        ("joint_reference", "position", "reference_position"),
    ):
        np.testing.assert_array_equal(getattr(reader.columns(topic), field)[:, 0], pair.fit[name])


def test_the_bag_says_nothing_of_what_is_hidden(pair, tmp_path):
    folder = write_bag(tmp_path / "bag", ["joint_1"], pair.fit, pair.model["robot"], pair.period, {})
    folder = folder if folder.is_dir() else folder.parent
    text = b"".join(path.read_bytes() for path in folder.iterdir())
    for word in (*VOCABULARY, "seed", "strength"):
        assert word.encode() not in text, word


def test_equal_seeds_make_equal_bags(pair, tmp_path):
    files = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_bag(tmp_path / name / "bag", ["joint_1"], pair.fit, pair.model["robot"], pair.period, {})
        files.append((tmp_path / name / "bag" / "bag_0.mcap").read_bytes())
    assert files[0] == files[1]


def test_an_arm_with_hidden_effects_follows_its_reference(monkeypatch):
    """A short recording; 5 mrad: chain with lowered gains, strong effects on two joints."""
    monkeypatch.setattr("hd_sim.puzzles.arm_recordings.FIT_S", 24.0)
    monkeypatch.setattr("hd_sim.puzzles.arm_recordings.HELD_OUT_S", 20.0)
    effects = [HiddenEffect("joint_2", "stribeck_friction", 2.0), HiddenEffect(5, "gauge_fourth_harmonic", 2.0)]
    arm = make_arm_pair(3, effects)
    error = arm.fit["joint_position"] - arm.fit["reference_position"]
    assert np.abs(error).max() < 5e-3
    assert arm.truth["joints"]["joint_2"]["names"] == ["stribeck_friction"]
    assert arm.truth["joints"]["joint_6"]["unknown"] == ["gauge_fourth_harmonic"]
    assert set(arm.models) == set(arm.joint_names)
    assert all(0.97 <= m["effects"]["rotor_inertia"]["rotor_inertia"] / 28.0 <= 1.03 for m in [arm.models["joint_1"]])


def test_arm_effects_lie_on_different_joints():
    names = tuple(f"joint_{i}" for i in range(1, 8))
    for seed in range(30):
        joints = [effect.joint for effect in draw_arm_effects(seed, names)]
        assert 1 <= len(joints) <= 3 and len(set(joints)) == len(joints)
