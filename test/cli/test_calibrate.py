"""hd calibrate: from a recorded slow turn with a hidden bridge error to fusion parameters that take it off."""

import json

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import fusion
from hd_sim.plant_config import PlantConfig
from hd_sim.recording import RunRecording
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import find_scenario, make_plan

HIDDEN = {"gauge_gain_error": -0.03, "gauge_offset": 1.2, "extra_ripple_cosine": 0.5, "extra_ripple_sine": -0.25}


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """Bag of a slow turn of joint 5 alone, and the drive's true joint torque."""
    config = PlantConfig.from_file("single_joint_5").with_settings(**{name: [v] for name, v in HIDDEN.items()})
    runner = Runner(RunSetup(config, 4))
    start, limit = runner.world.seam.plant.config.start_position, runner.goal_limits.velocity
    plan = make_plan(find_scenario("slow_turn"), runner.robot.joint_names, start, limit, runner.period)
    path = tmp_path_factory.mktemp("calibrate") / "turn"
    with RunRecording(path, config.robot, config.period, {"seed": "4"}) as recording:
        runner.run(plan, recording.observe)
    return path


@pytest.fixture(scope="module")
def written(turned):
    """The parameter file and the JSON document."""
    output, document = turned.parent / "fusion.yaml", turned.parent / "found.json"
    command = ["calibrate", str(turned), "--model", "single_joint_5", "-o", str(output), "--json", str(document)]
    assert main([*command, "--quiet"]) == 0
    return output, json.loads(document.read_text())


def test_file_is_what_the_fusion_node_reads(written):
    values = load_params_file(written[0], "fusion_node")
    assert fusion.configure(values, None, 1e-3).joints == 7
    shipped = load_params_file_shipped()
    changed = {name for name in values if values[name] != shipped[name]}
    assert changed == {"gauge_gain", "gauge_offset", "gauge_cosine_2", "gauge_sine_2", "gauge_cosine_4", "gauge_sine_4"}
    for name in changed:
        assert [a == b for a, b in zip(values[name], shipped[name], strict=True)] == [True] * 4 + [False] + [True] * 2


def load_params_file_shipped():
    from hd_control.core.resources import config_path

    return load_params_file(config_path("fusion_node.yaml"), "fusion_node")


def test_estimates_are_the_hidden_values(written):
    values = load_params_file(written[0], "fusion_node")
    assert values["gauge_gain"][4] == pytest.approx(1.0 + HIDDEN["gauge_gain_error"], abs=5e-3)
    assert values["gauge_offset"][4] == pytest.approx(HIDDEN["gauge_offset"], abs=0.02)
    assert values["gauge_cosine_2"][4] == pytest.approx(HIDDEN["extra_ripple_cosine"], abs=0.03)
    assert values["gauge_sine_2"][4] == pytest.approx(HIDDEN["extra_ripple_sine"], abs=0.03)


def test_the_document_has_errors_and_gain(written):
    found = written[1]
    assert found["schema"] == "hd.calibrate/1"
    joint = found["joints"]["joint_5"]
    assert joint["rms_after"] < 0.4 * joint["rms_before"]
    assert joint["parameters"]["gauge_gain"]["error"] < 0.01
    assert joint["wave_generator_turns"] > 10


def test_fusion_with_the_file_shows_the_weight_that_the_joint_holds(written):
    """Holding still, the joint torque is the weight: with the file it is read, without it 1.2 N m and ripple off."""
    config = PlantConfig.from_file("single_joint_5").with_settings(**{name: [v] for name, v in HIDDEN.items()})
    values = load_params_file(written[0], "fusion_node")
    errors = {}
    for name, own in (("old", {}), ("new", {"fusion_node": values})):
        runner = Runner(RunSetup(config, 9, own))
        rows = []
        for _ in range(1500):
            plant = runner.world.seam.plant
            weight = float(plant.gravity_torque(plant.true_joint_position)[0])
            rows.append(runner.step()["joint_states"]["effort"][0] - weight)
        errors[name] = abs(float(np.mean(rows[500:])))
    assert errors["new"] < 0.05 < 0.5 < errors["old"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--joint", "joint_1"], "joint_1: not in recording, parameters and model together; there is joint_5"),
        (["--model", "nothing"], "nothing"),
        (["--params", "torque_node.yaml"], "unknown parameter of fusion law"),
    ],
)
def test_wrong_inputs_are_one_line(turned, tmp_path, capsys, words, text):
    output = tmp_path / "out.yaml"
    assert main(["calibrate", str(turned), "--model", "single_joint_5", "-o", str(output), *words]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1
    assert not output.exists()


def test_an_existing_file_is_not_overwritten(turned, written, capsys):
    assert main(["calibrate", str(turned), "--model", "single_joint_5", "-o", str(written[0])]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_recording_at_rest_is_refused(tmp_path, capsys):
    config = PlantConfig.from_file("single_joint_5")
    runner = Runner(RunSetup(config))
    with RunRecording(tmp_path / "rest", config.robot, config.period, {"seed": "0"}) as recording:
        for _ in range(2500):
            recording.observe(runner.tick, runner.step())
    words = ["calibrate", str(tmp_path / "rest"), "--model", "single_joint_5", "-o", str(tmp_path / "out.yaml")]
    assert main(words) == 2
    assert "a calibration needs 2 turns" in capsys.readouterr().err
    assert not (tmp_path / "out.yaml").exists()
