"""hd replay: exit codes, what is said of changes, bags that do not fit."""

import json
import shutil

import pytest

from hd_control.cli.main import main
from hd_control.core.resources import config_path
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant_config import PlantConfig
from hd_sim.recording import RunRecording
from hd_sim.runner import Runner, RunSetup

GOLDEN = config_path().parent / "bags" / "golden" / "adaptive_joint"


def answer(tmp_path, *words):
    """Exit code and JSON of a replay."""
    target = tmp_path / "answer.json"
    target.unlink(missing_ok=True)
    code = main(["replay", *map(str, words), "--json", str(target)])
    return code, json.loads(target.read_text()) if target.exists() else {}


def test_what_would_have_been_commanded_is_written_and_replays(tmp_path, capsys):
    new = tmp_path / "new"
    code, said = answer(tmp_path, GOLDEN, "--set", "torque_node.torque_gain=[0.1]", "-o", new)
    assert code == 0 and said["schema"] == "hd.replay/1" and said["changed"] == {"torque_node": {"torque_gain": [0.1]}}
    assert not said["identical"] and "what would have been commanded differs" in capsys.readouterr().out
    page = tmp_path / "page.html"
    assert answer(tmp_path, GOLDEN, "--set", "torque_node.torque_gain=[0.1]", "--html", page)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert "motor_torque_command effort: largest difference" in text and 'src="http' not in text
    assert "joint_states position: largest" not in text and main(["replay", str(GOLDEN), "--html", str(page)]) == 2
    code, said = answer(tmp_path, new)
    assert code == 0 and said["identical"] and said["changed"] == {}


def test_a_model_and_a_file_change_the_command(tmp_path):
    own = tmp_path / "motion_node.yaml"
    own.write_text("/**:\n  ros__parameters:\n    integral_gain: [20000.0]\n    joint_names: [joint_3]\n")
    code, said = answer(tmp_path, GOLDEN, "--params", own)
    assert code == 0 and list(said["changed"]) == ["motion_node"] and not said["identical"]
    assert {one["topic"] for one in said["outputs"] if one["largest"] > 1e-9} == {
        "joint_torque_required", "motor_torque_command",
    }  # fmt: skip


def test_other_numbers_than_recorded_are_a_no(tmp_path, capsys):
    """The bag does not say that its run had another gain."""
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_5"), 1, {"torque_node": {"torque_gain": [0.9] * 7}}))
    with RunRecording(tmp_path / "bag", runner.robot, runner.period, {}) as recording:
        for tick in range(60):
            recording.observe(tick, runner.step())
    code, said = answer(tmp_path, tmp_path / "bag")
    assert code == 1 and not said["identical"]
    text = capsys.readouterr().out
    assert "the chain no longer gives the recorded numbers" in text and "no parameters in the bag; as shipped" in text


def test_a_cut_bag_is_replayed_as_far_as_it_goes(tmp_path):
    shutil.copytree(GOLDEN, tmp_path / "cut")
    (file,) = (tmp_path / "cut").glob("*.mcap")
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 3 // 4])
    code, said = answer(tmp_path, tmp_path / "cut")
    assert code == 3 and said["ticks"] > 0 and said["problems"]


def test_bad_bags_are_one_clear_line(tmp_path, capsys):
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)) * 40)
    names = ("joint_3",)
    with BagWriter(tmp_path / "poor", live=False) as writer:
        writer.write_columns("encoder", joint_state_codec("encoder", names), [0, 1_000_000], frame_id="x" * 16,
                             position=[[0.0], [0.1]])  # fmt: skip
    cases = [
        ([tmp_path / "none"], "no such bag"),
        ([tmp_path / "noise.mcap"], "noise.mcap"),
        ([tmp_path / "poor"], "resolver, gauge_bridge, motor_torque_applied not recorded"),
        ([GOLDEN, "--robot", "arm_a"], "encoder has 1 joints (joint_3), the robot 7"),
        ([GOLDEN, "--set", "torque_node.tork=1"], "no parameter 'tork'"),
        ([GOLDEN, "--params", "plant_node.yaml"], "no node that counts here"),
        ([GOLDEN, "--live", "--rate", "0"], "must be above 0"),
    ]
    for words, expected in cases:
        code, _ = answer(tmp_path, *words)
        error = capsys.readouterr().err
        assert code == 2 and error.count("\n") == 1 and expected in error, error


@pytest.mark.parametrize("limits", ["no_such.yaml"])
def test_limits_that_are_not_there(tmp_path, capsys, limits):
    assert answer(tmp_path, GOLDEN, "--limits", limits)[0] == 2
    assert limits in capsys.readouterr().err
