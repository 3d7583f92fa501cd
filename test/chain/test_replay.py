"""Replay: the runner's recordings come back bit for bit, the golden bags guard the laws, differences are found."""

from dataclasses import replace

import numpy as np
import pytest
from golden_bags import CASES, FOLDER, record

from hd_control.chain.replay import OUTPUTS, complete_values, differences, read_replay_bag, replay
from hd_control.core.errors import BagError, ConfigError
from hd_control.core.robot import Robot
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

ROUNDING = 1e-6
"""N m, rad, rad/s: what another processor's sine may change; the smallest torque of interest is 1e-3 N m."""


def again(bag, changes=None, **options):
    """Differences of a replay by topic and field."""
    made = replay(bag, complete_values(bag, changes), **options)
    return {(one.topic, one.field): one for one in differences(bag, made)}, made


@pytest.mark.parametrize("name", CASES)
def test_the_laws_still_give_the_golden_torques(name):
    bag = read_replay_bag(FOLDER / name)
    found, made = again(bag)
    assert len(found) == 10 and all(one.compared == CASES[name][1] for one in found.values())
    assert made.notes == made.faults == () and len(bag.goals) == 1
    for one in found.values():
        assert one.largest <= ROUNDING, one
    moved = np.ptp(bag.topics["joint_reference"]["position"], axis=0)
    assert (moved > 0.004).all(), "the recording moves every joint"


def test_an_unchanged_recording_comes_back_bit_for_bit(tmp_path):
    bag = read_replay_bag(record(tmp_path / "bag", "arm_a", 120, {"torque_node": {"rate_source": "plain"}}))
    found, _ = again(bag)
    assert {one.first_tick for one in found.values()} == {None} and found[
        "motor_torque_command", "effort"
    ].largest == 0.0


def test_a_changed_gain_shows_where_and_when(tmp_path):
    bag = read_replay_bag(FOLDER / "adaptive_arm")
    gain = list(complete_values(bag)["torque_node"]["torque_gain"])
    gain[4] *= 1.1
    found, _ = again(bag, {"torque_node": {"torque_gain": gain}})
    command = found.pop(("motor_torque_command", "effort"))
    assert command.joint == "joint_5" and command.largest > 1e-3 and command.first_tick is not None
    assert max(one.largest for one in found.values()) <= ROUNDING, "only the torque law uses it"


def test_recorded_inputs_show_where_a_difference_arises():
    bag, change = read_replay_bag(FOLDER / "adaptive_joint"), {"fusion_node": {"gauge_offset": [3.0]}}
    chained, _ = again(bag, change)
    alone, _ = again(bag, change, recorded_inputs=True)
    assert chained["motor_torque_command", "effort"].largest > 0.1
    assert alone["joint_states", "effort"].largest == pytest.approx(2.5 / 1.02, rel=1e-6)
    assert alone["motor_torque_command", "effort"].largest <= ROUNDING


def test_ticks_without_all_sensors_are_left_out(tmp_path):
    source = read_replay_bag(FOLDER / "adaptive_arm")
    path, stamps = tmp_path / "holes", source.ticks * 1_000_000
    with BagWriter(path, live=False, metadata={"period": "0.001"}) as writer:
        writer.attach("robot.urdf", source.robot.urdf)
        for topic, table in source.topics.items():
            kept = np.ones(stamps.size, dtype=bool)
            kept[50:53] = topic != "gauge_bridge"
            codec = joint_state_codec(topic, source.robot.joint_names)
            arrays = {name: values[kept] for name, values in table.items()}
            writer.write_columns(topic, codec, stamps[kept], frame_id="x" * 16, **arrays)
    bag = read_replay_bag(path)
    assert bag.left_out == 3 and bag.ticks.size == source.ticks.size - 3 and 51 not in bag.ticks
    found, _ = again(bag)
    assert found["joint_states", "position"].compared == bag.ticks.size
    first = found["motor_torque_command", "effort"].first_tick
    assert first == 21, "equal until the goal moves, which this bag does not have"


def test_a_goal_without_a_stamp_starts_where_the_reference_moved():
    bag = read_replay_bag(FOLDER / "adaptive_arm")
    from hd_control.chain.replay import _dated

    row, goal = bag.goals[0]
    _, dated = _dated(replace(goal, start_tick=None), row, bag.ticks, bag.topics["joint_reference"])
    assert dated.start_tick == goal.start_tick


def test_other_joints_are_refused():
    bag = read_replay_bag(FOLDER / "adaptive_arm")
    with pytest.raises(BagError, match="encoder has 7 joints"):
        read_replay_bag(FOLDER / "adaptive_arm", Robot.from_file("single_joint_3"))
    with pytest.raises(ConfigError, match="the parameters are for 1 joints"):
        complete_values(bag, {"torque_node": {"joint_names": ["joint_3"]}})
    with pytest.raises(ConfigError, match="no parameter 'tork_gain'"):
        complete_values(bag, {"torque_node": {"tork_gain": 1.0}})
    assert {topic for topic in bag.topics if topic in OUTPUTS} == set(OUTPUTS)
