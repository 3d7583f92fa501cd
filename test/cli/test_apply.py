"""hd apply: files that differ where the model knows something, a table with reasons, one clear line for bad input."""

import json

import pytest

from hd_control.cli.main import main
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import with_changes, yaml_value
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file, parse_yaml
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.drive.model_file import save_model


@pytest.fixture
def model(tmp_path):
    value = ModelValue(2e-4, source="fitted", interval=(1.9e-4, 2.1e-4))
    offset = ModelValue(-1.5, source="fitted", interval=(-1.6, -1.4))
    effects = {"kinematic_error": {"sine_2": value}, "gauge_offset": {"gauge_offset": offset}}
    path = tmp_path / "better.yaml"
    save_model(Model(None, {"joint_3": JointModel(120.0, effects=effects)}), path)
    return path


def changed_lines(path):
    """Lines of a written file that the shipped one does not have."""
    shipped = (config_path() / path.name).read_text().splitlines()
    return [line.strip() for line in path.read_text().splitlines() if line not in shipped]


def test_both_files_change_only_where_the_model_knows_something(model, tmp_path, capsys):
    out = tmp_path / "tuned"
    assert main(["apply", "--model", str(model), "-o", str(out), "--json", str(tmp_path / "a.json")]) == 0
    text = capsys.readouterr().out
    assert "torque_node kinematic_sine_2: 0 -> 0.0002 rad" in text and "fusion_node gauge_offset: 0 -> -1.5 N m" in text
    assert len(changed_lines(out / "torque_node.yaml")) == 2 and len(changed_lines(out / "fusion_node.yaml")) == 2
    values = load_params_file(out / "torque_node.yaml", "torque_node")
    assert (
        values["kinematic_sine_2"] == [0.0, 0.0, 2e-4, 0.0, 0.0, 0.0, 0.0] and values["kinematic_feedforward"] is True
    )
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["schema"] == "hd.apply/1" and set(document["changed"]["fusion_node"]) == {
        "kinematic_sine_2",
        "gauge_offset",
    }


def test_a_partial_file_of_the_user_keeps_its_words(model, tmp_path):
    own = tmp_path / "torque_node.yaml"
    own.write_text(
        "/**:\n  ros__parameters:\n    # mine\n    torque_gain: [0.0, 0.0, 0.1, 0.8, 0.75, 0.75, 1.0]  # tuned\n"
    )
    assert main(["apply", "--model", str(model), "--params", str(own), "-o", str(tmp_path / "new.yaml")]) == 0
    text = (tmp_path / "new.yaml").read_text()
    assert text.startswith(own.read_text())
    assert "kinematic_feedforward: true  # from better.yaml" in text


def test_nothing_to_apply_is_a_no(tmp_path, capsys):
    assert main(["apply", "--model", "arm_a", "-o", str(tmp_path / "tuned")]) == 1
    assert "no interval (datasheet)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([], "give -o FILE"),
        (["-o", "{tmp}/x", "--live"], "give -o FILE"),
        (["-o", "{tmp}/none/x"], "does not exist"),
        (["-o", "{tmp}/x", "--params", "nodes.yaml"], "no node that counts here"),
        (["-o", "{tmp}/x", "--params", "{tmp}/better.yaml"], "not a params file|no section"),
        (["-o", "{tmp}/x", "--params", "torque_node.yaml", "--params", "torque_node.yaml"], "give each node once"),
        (["-o", "{tmp}/x", "--joint", "joint_1"], "joint_1: the model has joint_3"),
        (["-o", "{tmp}/x", "--diagnosis", "{tmp}/better.yaml"], "not the JSON of hd diagnose"),
    ],
)
def test_bad_input_is_one_clear_line(model, tmp_path, capsys, more, words):
    code = main(["apply", "--model", str(model), *(word.format(tmp=tmp_path) for word in more)])
    error = capsys.readouterr().err
    assert code == 2 and error.count("\n") == 1 and any(word in error for word in words.split("|")), error
    assert not (tmp_path / "x").exists()


def test_an_uncertain_name_is_left_out(model, tmp_path, capsys):
    said = {"joints": {"joint_3": {"effects": [{"name": "gauge_offset", "confusable_with": ["asymmetric_friction"]}]}}}
    (tmp_path / "said.json").write_text(json.dumps(said))
    out = tmp_path / "tuned"
    assert main(["apply", "--model", str(model), "-o", str(out), "--diagnosis", str(tmp_path / "said.json")]) == 0
    assert "its name is not certain: it may be asymmetric_friction" in capsys.readouterr().out
    assert load_params_file(out / "fusion_node.yaml", "fusion_node")["gauge_offset"] == [0.0] * 7


def test_values_read_back_as_themselves():
    for value in (1e-6, -2.5e300, 3.0, True, "direct", [1.0, 2e-7], ["", "a b"], 4):
        assert parse_yaml(f"x: {yaml_value(value)}", "here") == {"x": value}


def test_a_value_over_several_lines_is_refused():
    text = "/**:\n  ros__parameters:\n    gauge_gain: [1.0,\n      2.0]\n"
    with pytest.raises(ConfigError, match="over several lines"):
        with_changes(text, {"gauge_gain": [3.0, 2.0]}, "from m", "here")
