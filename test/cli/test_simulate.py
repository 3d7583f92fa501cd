"""`hd simulate` as a user types it."""

import json
from pathlib import Path

import pytest

from hd_control.cli.main import main
from hd_control.record.reader import BagReader


def _hd(*words: object) -> int:
    return main([str(word) for word in words])


def test_a_run_with_a_hidden_effect_keeps_the_truth_out_of_the_bag(tmp_path, capsys):
    bag = tmp_path / "run"
    hidden = ["--nominal", "--hide", "joint_3/stribeck_friction:2"]
    code = _hd("simulate", "rest", "-o", bag, *hidden, "--json", tmp_path / "r.json")
    assert code == 0
    assert (tmp_path / "run.seal").exists()
    assert "sealed" in capsys.readouterr().out
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["schema"] == "hd.simulate/1" and result["ticks"] == 2000
    with BagReader(bag) as reader:
        texts = [name + value for record in reader.metadata.values() for name, value in record.items()]
        content = b"".join([*reader.attachments.values(), *(text.encode() for text in texts)])
        assert len(reader.columns("encoder")) == 2000
    for secret in (b"stribeck", b"hide", b"seal"):
        assert secret not in content
    assert not any(secret in path.read_bytes() for path in Path(bag).iterdir() for secret in (b"stribeck", b"hide"))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["walk"], "unknown scenario 'walk'"),
        (["rest", "--hide", "stribek_friction"], "did you mean 'stribeck_friction'"),
        (["rest", "--hide", "joint_9/backlash"], "unknown joint 'joint_9'"),
        (["rest", "--hide", "backlash:strong"], "'strong' is not a number"),
        (["rest", "--set", "torque_node.gian=1"], "no parameter 'gian'"),
        (["rest", "--set", "wheel_node.a=1"], "NODE.PARAM=VALUE"),
        (["rest", "--set", "torque_node.torque_gain=[1"], "torque_gain"),
        (["rest", "--set", "torque_node.torque_rate_gain=[1,1,1,1,1,1,1]"], "Remark 3.1"),
        (["rest", "--plant", "arm_x"], "arm_x"),
        (["rest", "--delay", "0"], "outside [1, 17]"),
        ([], "give a scenario"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(tmp_path, capsys, words, says):
    assert _hd("simulate", *words, "-o", tmp_path / "bag") == 2
    printed = capsys.readouterr().err.strip()
    assert says in printed and "\n" not in printed
    assert list(tmp_path.iterdir()) == []


def test_an_existing_bag_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "bag").mkdir()
    assert _hd("simulate", "rest", "-o", tmp_path / "bag") == 2
    assert "exists already" in capsys.readouterr().err


def test_the_list_names_scenarios_and_effects(capsys):
    assert _hd("simulate", "--list") == 0
    printed = capsys.readouterr().out
    assert "coordinated" in printed and "backlash" in printed and "outside the library" in printed
