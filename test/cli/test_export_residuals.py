"""Residuals and layouts for plotting tools; published measurements, where they are on this machine."""

from __future__ import annotations

import json
import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.core.errors import BagError
from hd_control.lab.models.answers import residual_pages, residual_series
from hd_control.lab.signals.checks import check_signals
from hd_control.lab.signals.recording import read_recording
from hd_control.record.reader import BagReader
from hd_control.record.tables import foxglove_layout, plotjuggler_layout, topic_name, write_series_bag

DATA = Path(os.environ.get("HD_MEASURED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def hd(*words: object) -> int:
    return main([str(word) for word in words])


def comparisons() -> dict[str, dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    time = np.arange(500) * 8e-3
    residual = np.where((time > 1.0) & (time < 1.5), np.nan, np.sin(time))
    return {"joint_1": {"motor_torque": (time, residual, 2.0 * residual), "transmission": (time, residual, residual)}}


def test_residuals_come_back_from_their_bag_on_the_clock_of_the_recording(tmp_path: Path) -> None:
    start = 1_700_000_000_000_000_000
    path = write_series_bag(tmp_path / "residuals", residual_series(comparisons(), start))
    time, residual, _ = comparisons()["joint_1"]["motor_torque"]
    with BagReader(path) as bag:
        assert set(bag.topics.values()) == {"std_msgs/msg/Float64"} and len(bag.topics) == 4
        columns = bag.columns("/residual/joint_1/motor_torque")
        good = np.isfinite(residual)
        assert np.array_equal(columns.values["data"][:, 0], residual[good])
        assert np.array_equal(columns.stamps_ns, start + np.round(time[good] * 1e9).astype(np.int64))
        objects = [message.data for _, message in bag.messages("/residual/joint_1/motor_torque")]
        assert objects == residual[good].tolist()
    with pytest.raises(BagError, match="no series"):
        write_series_bag(tmp_path / "none", {})


def test_the_layouts_show_every_series(tmp_path: Path) -> None:
    series, pages = residual_series(comparisons()), residual_pages(comparisons())
    foxglove = json.loads(foxglove_layout(pages))
    plots = [panel for name, panel in foxglove["configById"].items() if name.startswith("Plot!")]
    assert {path["value"] for panel in plots for path in panel["paths"]} == {f"/{name}.data" for name in series}
    (tabs,) = (panel["tabs"] for name, panel in foxglove["configById"].items() if name == foxglove["layout"])
    shown: list[str] = []

    def collect(node: object) -> None:
        if isinstance(node, dict):
            collect(node["first"])
            collect(node["second"])
        else:
            shown.append(str(node))

    for tab in tabs:
        collect(tab["layout"])
    assert sorted(shown) == sorted(name for name in foxglove["configById"] if name.startswith("Plot!"))
    juggler = ElementTree.fromstring(plotjuggler_layout(pages))
    assert {curve.get("name") for curve in juggler.iter("curve")} == {f"/{name}/data" for name in series}
    assert [tab.get("tab_name") for tab in juggler.iter("Tab")] == ["joint_1"]
    assert topic_name("residual", "axis-1.b", "7th") == "residual/axis_1_b/_7th"


def test_residuals_of_a_shipped_model(tmp_path: Path) -> None:
    bag, model = tmp_path / "run", "config/models/single_joint_4.yaml"
    root = Path(__file__).resolve().parents[2]
    assert hd("simulate", "sine_joint_4_0p5hz", "-o", bag, "--quiet") == 0
    out = tmp_path / "residuals"
    assert hd("export", bag, "--residuals", root / model, "-o", out, "--json", tmp_path / "e.json") == 0
    files = [Path(name).name for name in json.loads((tmp_path / "e.json").read_text())["files"]]
    assert files == ["residuals", "residuals.foxglove.json", "residuals.plotjuggler.xml"]
    with BagReader(out) as series:
        kinds = {name.split("/")[1] for name in series.topics}
        assert kinds == {"measured", "residual"}
        assert len({name.split("/")[3] for name in series.topics}) >= 2
    assert hd("export", bag, "--residuals", root / model, "-o", out) == 2
    assert hd("export", bag, "--residuals", root / model, "-o", out, "--force") == 0


@pytest.mark.skipif(not (DATA / "iiwa").is_dir(), reason="no measured data on this machine")
@pytest.mark.parametrize("name", ["j4_v0p30", "j2_chirp"])
def test_measured_iiwa_data_is_imported_and_its_sign_is_right(tmp_path: Path, name: str) -> None:
    assert hd("import", DATA / "iiwa" / f"{name}.npz", "--map", "iiwa", "-o", tmp_path / "bag") == 0
    recording = read_recording(tmp_path / "bag")
    assert len(recording.joints) == 7 and recording.problems == ()
    joint = recording.joints["joint_4" if name.startswith("j4") else "joint_2"]
    raw = np.load(DATA / "iiwa" / f"{name}.npz")
    index = 3 if name.startswith("j4") else 1
    assert np.array_equal(joint.joint_position[joint.valid][:1000], raw["q"][:1000, index])
    assert np.array_equal(joint.gauge_torque[joint.valid][:1000], -raw["tau"][:1000, index].astype(float))
    sentences = check_signals(joint, 160.0)
    assert not any("flipped" in text for text in sentences)
    if name == "j2_chirp":  # the source's description: about 55 ms, and five gaps
        assert any("gauge_torque" in text and "late" in text for text in sentences)
        assert any("5 gaps" in note for note in joint.notes)


@pytest.mark.skipif(not (DATA / "ur10").is_dir(), reason="no measured data on this machine")
def test_measured_ur10_data_is_imported(tmp_path: Path) -> None:
    (source,) = (DATA / "ur10").glob("*.npz")
    assert hd("import", source, "--map", "ur10", "-o", tmp_path / "bag") == 0
    recording = read_recording(tmp_path / "bag")
    assert len(recording.joints) == 6 and recording.joints["elbow"].period == pytest.approx(8e-3)
    assert all(check_signals(joint, 100.0) == () for joint in recording.joints.values())
