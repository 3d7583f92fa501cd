"""compare, diagnose, add, ladder and report as a user runs them: answers, files, exit codes, bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.drive.model_file import load_model
from hd_sim.puzzles.draw import chosen_case
from hd_sim.puzzles.recordings import record_pair, write_bag


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of a drive that hides a kinematic error, and its data sheet."""
    place = tmp_path_factory.mktemp("drive")
    assert (
        main(["challenge", "new", "--seed", "7", "--effect", "kinematic_error", "-o", str(place / "c"), "--quiet"]) == 0
    )
    return place / "c"


def document(path: Path) -> dict[str, Any]:
    """A JSON file."""
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_compare_prints_error_refit_noise_and_where(folder: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "compare.json"
    assert main(["compare", str(folder / "fit"), "--model", str(folder / "model.yaml"), "--json", str(out)]) == 0
    found = document(out)
    assert found["schema"] == "hd.compare/1" and len(found["bag"]["sha256"]) == len(found["model"]["sha256"]) == 64
    channels = found["joints"]["joint_1"]["channels"]
    assert set(channels) == {"motor_torque", "transmission", "link_torque"}
    for channel in channels.values():
        assert channel["rms_error"] >= channel["rms_error_refitted"] > 0.0
        assert 0.0 <= channel["structured_fraction"] <= 1.0
        assert channel["worst"] and channel["worst"][0]["share_of_error"] >= channel["worst"][-1]["share_of_error"]
    assert channels["transmission"]["rms_error_refitted"] > 3.0 * channels["transmission"]["noise_floor"]
    assert any("per wave-generator turn" in text for text in channels["transmission"]["order_lines"])
    assert set(found["joints"]["joint_1"]["free_run"]) == {"0.5", "5"}
    text = capsys.readouterr().out
    assert "hd add --refit" in text
    for head, key in (("sensors", "sensors"), ("delays", "delays"), ("friction", "friction")):
        assert head in text and found["joints"]["joint_1"][key], "what people look for first"
    assert set(found["joints"]["joint_1"]["spectra"]) == {"motor_torque", "gauge_torque", "torsion"}
    assert "sections" not in found["joints"]["joint_1"]


def test_diagnose_add_and_ladder_end_at_the_noise(folder: Path, tmp_path: Path) -> None:
    bag, nominal = str(folder / "fit"), str(folder / "model.yaml")
    out, better = tmp_path / "diagnosis.json", tmp_path / "better.yaml"
    assert main(["diagnose", bag, "--model", nominal, "--json", str(out), "--quiet", "--exit-code"]) == 1
    effects = document(out)["joints"]["joint_1"]["effects"]
    assert [effect["name"] for effect in effects] == ["kinematic_error"]
    assert effects[0]["held_out"] is True and effects[0]["error_after"] < 0.3 * effects[0]["error_before"]
    assert main(["add", "kinematic_error", "--model", nominal, "--bag", bag, "-o", str(better), "--quiet"]) == 0
    model = load_model(better)
    assert model.joint("joint_1").effects["kinematic_error"]["cosine_2"].source == "fitted"
    assert model.provenance[-1]["command"].startswith("hd add kinematic_error")
    assert main(["diagnose", bag, "--model", str(better), "--quiet", "--exit-code"]) == 0
    again = tmp_path / "again.yaml"
    assert main(["add", "kinematic_error", "--model", nominal, "--bag", bag, "-o", str(again), "--quiet"]) == 0
    assert again.read_bytes() == better.read_bytes(), "a model is reproducible from bag and command"


def test_signals_that_contradict_the_model_end_with_2_and_no_name(folder: Path, tmp_path: Path, capsys: Any) -> None:
    """A model with another gear ratio: nothing is named, the reason stands in text and JSON."""
    text = (folder / "model.yaml").read_text()
    ratio = load_model(folder / "model.yaml").joint("joint_1").gear_ratio
    wrong = folder / "wrong.yaml"
    wrong.write_text(text.replace(f"gear_ratio: {ratio}", f"gear_ratio: {ratio + 1.0}"))
    out = tmp_path / "d.json"
    assert main(["diagnose", str(folder / "fit"), "--model", str(wrong), "--json", str(out)]) == 2
    found = document(out)["joints"]["joint_1"]
    assert found["verdict"] == "cannot_tell" and found["effects"] == [] and found["unknown"] is None
    assert "gear ratio" in found["contradictions"][0]
    assert "contradict each other" in capsys.readouterr().out


def test_ladder_writes_rungs_and_the_last_model(folder: Path, tmp_path: Path) -> None:
    out, best = tmp_path / "ladder.json", tmp_path / "best.yaml"
    words = [
        "ladder",
        str(folder / "fit"),
        "--held-out",
        str(folder / "held_out"),
        "--model",
        str(folder / "model.yaml"),
    ]
    assert main([*words, "-o", str(best), "--json", str(out), "--quiet"]) == 0
    found = document(out)["joints"]["joint_1"]
    assert [rung["effect"] for rung in found["rungs"]] == ["as given", "refit", "kinematic_error"]
    assert found["rungs"][-1]["error_held_out"] < 1.1 * found["rungs"][-1]["noise_floor"]
    assert found["stopped_because"]
    assert load_model(best).joint("joint_1").effects["kinematic_error"]


def test_report_is_one_page(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    words = [
        "report",
        str(folder / "fit"),
        "--model",
        str(folder / "model.yaml"),
        "-o",
        str(page),
        "--no-ladder",
        "--quiet",
    ]
    assert main(words) == 0
    text = page.read_text()
    assert "Kinematic error is missing in the model." in text
    assert main(words) == 2, "nothing is overwritten without --force"
    assert main(["report", *words[1:4], "-o", str(tmp_path / "page.txt")]) == 2


@pytest.mark.parametrize("command", ["compare", "diagnose"])
def test_no_such_bag_or_model_is_one_line(command: str, folder: Path, tmp_path: Path, capsys: Any) -> None:
    assert main([command, str(tmp_path / "none"), "--model", str(folder / "model.yaml")]) == 2
    assert main([command, str(folder / "fit"), "--model", str(tmp_path / "none.yaml")]) == 2
    assert main([command, str(folder / "fit"), "--model", str(folder / "model.yaml"), "--joint", "elbow"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3 and all(line.startswith("hd: ") for line in lines)
    assert "elbow" in lines[2] and "joint_1" in lines[2]


def test_add_refuses_what_makes_no_sense(folder: Path, tmp_path: Path, capsys: Any) -> None:
    words = ["--model", str(folder / "model.yaml"), "--bag", str(folder / "fit"), "-o", str(tmp_path / "m.yaml")]
    assert main(["add", "kinematic_eror", *words]) == 2
    assert "kinematic_error" in capsys.readouterr().err
    assert main(["add", "coulomb_friction", *words]) == 2
    assert main(["add", *words]) == 2
    (tmp_path / "m.yaml").write_text("mine")
    assert main(["add", "kinematic_error", *words]) == 2
    assert (tmp_path / "m.yaml").read_text() == "mine"


def test_a_truncated_bag_is_read_as_far_as_whole(folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(folder / "fit", broken)
    storage = next(broken.glob("*.mcap"))
    data = storage.read_bytes()
    storage.write_bytes(data[: int(0.7 * len(data))])
    assert main(["diagnose", str(broken), "--model", str(folder / "model.yaml"), "--quiet"]) == 3


@pytest.fixture(scope="module")
def columns() -> tuple[dict[str, np.ndarray], str]:
    """Columns of a healthy recording, and its robot."""
    pair = record_pair(chosen_case(7, {}))
    return dict(pair.fit), str(pair.model["robot"])


@pytest.mark.parametrize("what", ["three seconds", "nan", "constant", "ratio"])
def test_recordings_that_cannot_decide_are_refused(
    what: str, columns: tuple[dict[str, np.ndarray], str], folder: Path, tmp_path: Path, capsys: Any
) -> None:
    signals, robot = columns
    changed = {name: values.copy() for name, values in signals.items()}
    if what == "three seconds":
        changed = {name: values[:3000] for name, values in changed.items()}
    elif what == "nan":
        changed["motor_torque"][:] = np.nan
    elif what == "constant":
        for name in ("motor_shaft_position", "joint_position"):
            changed[name][:] = changed[name][0]
    model = folder / "model.yaml"
    if what == "ratio":
        text = model.read_text()
        line = next(x for x in text.splitlines() if "gear_ratio" in x)
        model = tmp_path / "ratio.yaml"
        shutil.copy(folder / "robot.urdf", tmp_path)
        model.write_text(text.replace(line, line.rpartition(":")[0] + ": 33.0"))
    names = {"time", "reference_velocity"}
    bag = write_bag(
        tmp_path / "bag", ["joint_1"], {n: v for n, v in changed.items() if n not in names}, robot, 1e-3, {}
    )
    out = tmp_path / "d.json"
    ends = (2,) if what == "ratio" else (0, 3)
    assert main(["diagnose", str(bag), "--model", str(model), "--json", str(out)]) in ends
    found = document(out)["joints"]["joint_1"]
    said = capsys.readouterr().out
    if what in ("three seconds", "constant"):
        assert found["verdict"] == "cannot_tell" and found["experiments"]
    elif what == "nan":
        assert "motor_torque" not in found["channels"]
    else:
        assert "gear ratio" in said and found["verdict"] == "cannot_tell"


def test_a_seal_beside_the_bag_is_never_opened(folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened: list[str] = []
    real = Path.open

    def watched(self: Path, *args: Any, **kwargs: Any) -> Any:
        opened.append(self.name)
        return real(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", watched)
    assert (folder / "truth.seal").exists()
    assert main(["diagnose", str(folder / "fit"), "--model", str(folder / "model.yaml"), "--quiet"]) == 0
    assert "truth.seal" not in opened and opened
