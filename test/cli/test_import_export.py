"""`hd import` and `hd export` as a user types them."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.lab.signals import import_table as import_module
from hd_control.lab.signals.recording import read_recording
from hd_control.record.reader import BagReader

DATA = Path(os.environ.get("HD_MEASURED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
"""Measured data of real robots; it is never part of this project."""
MAPPING = """
joints: {shoulder: a1, elbow: a2}
time: {column: t, unit: ms}
signals:
  joint_position: {columns: "q_{joint}", unit: deg}
  joint_velocity: {columns: "qd_{joint}", unit: rpm}
  gauge_torque: {columns: "tau_{joint}", sign: -1}
  temperature: {columns: {elbow: warm}, unit: K}
"""


def hd(*words: object) -> int:
    return main([str(word) for word in words])


def table(rows: int = 600) -> dict[str, np.ndarray]:
    """A foreign robot's log, 200 Hz."""
    time = 5.0 * np.arange(rows)
    return {
        "t": time,
        "q_a1": 40.0 * np.sin(1e-3 * time),
        "q_a2": 20.0 * np.cos(2e-3 * time),
        "qd_a1": np.ones(rows),
        "qd_a2": np.zeros(rows),
        "tau_a1": np.sin(3e-3 * time),
        "tau_a2": 5.0 + 0.0 * time,
        "warm": 300.0 + 1e-3 * time,
        "remark": np.zeros(rows),
    }


def write_csv(path: Path, columns: dict[str, np.ndarray], delimiter: str = ",") -> Path:
    with path.open("w", newline="") as stream:
        stream.write("# log of a robot\n")
        writer = csv.writer(stream, delimiter=delimiter)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            texts = ["" if np.isnan(x) else repr(float(x)) for x in row]
            writer.writerow([text.replace(".", ",") if delimiter == ";" else text for text in texts])
    return path


@pytest.fixture
def mapping(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(MAPPING)
    return path


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_csv_becomes_a_bag_in_si(tmp_path: Path, mapping: Path, delimiter: str) -> None:
    columns = table()
    columns["tau_a1"][100] = np.nan
    source = write_csv(tmp_path / "log.csv", columns, delimiter)
    assert hd("import", source, "--map", mapping, "-o", tmp_path / "bag", "--json", tmp_path / "i.json") == 0
    document = json.loads((tmp_path / "i.json").read_text())
    assert document["schema"] == "hd.import/1" and document["samples"] == 600 and document["problems"] == []
    recording = read_recording(tmp_path / "bag")
    assert list(recording.joints) == ["shoulder", "elbow"] and recording.problems == ()
    shoulder, elbow = recording.joints["shoulder"], recording.joints["elbow"]
    assert shoulder.period == pytest.approx(5e-3) and shoulder.temperature is None
    assert shoulder.joint_position == pytest.approx(np.deg2rad(columns["q_a1"]), abs=1e-12)
    good = np.isfinite(columns["tau_a1"])
    assert shoulder.gauge_torque[good] == pytest.approx(-columns["tau_a1"][good], abs=1e-12)
    assert shoulder.gauge_torque[100] == pytest.approx(-np.sin(1.5), abs=1e-6), "one missing number is bridged"
    assert elbow.temperature == pytest.approx(columns["warm"] - 273.15, abs=1e-9)
    assert "gauge_torque: constant at -5" in elbow.notes
    with BagReader(tmp_path / "bag") as bag:
        velocity = bag.columns("joint_states").velocity
        assert velocity is not None and velocity[:, 0] == pytest.approx(2.0 * np.pi / 60.0)


def test_export_and_import_give_the_same_signals_again(tmp_path: Path, mapping: Path) -> None:
    source = write_csv(tmp_path / "log.csv", table())
    assert hd("import", source, "--map", mapping, "-o", tmp_path / "bag") == 0
    first = read_recording(tmp_path / "bag")
    for ending in ("csv", "npz"):
        assert hd("export", tmp_path / "bag", "-o", tmp_path / f"out.{ending}") == 0
        assert hd("import", tmp_path / f"out.{ending}", "-o", tmp_path / f"again_{ending}") == 0
        again = read_recording(tmp_path / f"again_{ending}")
        assert list(again.joints) == list(first.joints)
        for name, joint in first.joints.items():
            assert again.joints[name].present == joint.present
            for signal in joint.present:
                assert getattr(again.joints[name], signal) == pytest.approx(
                    getattr(joint, signal), rel=1e-14, abs=1e-14
                )


def test_an_export_takes_a_part(tmp_path: Path, mapping: Path) -> None:
    assert hd("import", write_csv(tmp_path / "log.csv", table()), "--map", mapping, "-o", tmp_path / "bag") == 0
    words = ["--joint", "elbow", "--start", "1", "--seconds", "0.5"]
    assert hd("export", tmp_path / "bag", "-o", tmp_path / "part.csv", *words) == 0
    with (tmp_path / "part.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 100 and set(rows[0]) == {
        "time",
        "elbow.joint_position",
        "elbow.gauge_torque",
        "elbow.temperature",
    }
    assert float(rows[0]["elbow.joint_position"]) == pytest.approx(np.deg2rad(20.0 * np.cos(2.0)))


def test_rows_with_bad_times_are_dropped_and_counted(tmp_path: Path, mapping: Path, capsys) -> None:
    columns = table()
    columns["t"][50], columns["t"][300] = columns["t"][49], np.nan
    source = write_csv(tmp_path / "log.csv", columns)
    assert hd("import", source, "--map", mapping, "-o", tmp_path / "bag") == 3
    assert "2 of 600 rows dropped" in capsys.readouterr().out
    assert read_recording(tmp_path / "bag").joints["elbow"].valid.all()


def test_rounded_times_are_put_onto_their_period(tmp_path: Path) -> None:
    columns = table()
    columns["t"] = np.round(np.arange(600) * 10.0 / 3.0)
    mapping = tmp_path / "robot.yaml"
    mapping.write_text(MAPPING.replace("unit: ms", "unit: ms, period: 3.3333333333333333e-3"))
    assert hd("import", write_csv(tmp_path / "log.csv", columns), "--map", mapping, "-o", tmp_path / "bag") == 0
    recording = read_recording(tmp_path / "bag")
    assert recording.notes == () and recording.joints["elbow"].period == pytest.approx(1.0 / 300.0, rel=1e-9)


def test_nothing_is_overwritten_without_force(tmp_path: Path, mapping: Path, capsys) -> None:
    source = write_csv(tmp_path / "log.csv", table())
    bag, out = tmp_path / "bag", tmp_path / "out.csv"
    assert hd("import", source, "--map", mapping, "-o", bag) == 0
    before = {path: path.read_bytes() for path in bag.iterdir()}
    assert hd("import", source, "--map", mapping, "-o", bag) == 2
    assert {path: path.read_bytes() for path in bag.iterdir()} == before
    assert hd("import", source, "--map", mapping, "-o", bag, "--force") == 0
    out.write_text("mine")
    assert hd("export", bag, "-o", out) == 2 and out.read_text() == "mine"
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "cat.jpg").write_text("cat")
    assert hd("import", source, "--map", mapping, "-o", folder, "--force") == 2
    assert (folder / "cat.jpg").read_text() == "cat"
    assert "is not a bag" in capsys.readouterr().err
    assert not list(tmp_path.glob(".*")), "nothing half done stays"


def test_an_interrupt_leaves_nothing_behind(tmp_path: Path, mapping: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_csv(tmp_path / "log.csv", table())
    calls = []

    def stop(original: Callable[..., None]) -> Callable[..., None]:
        def write(*words: object) -> None:
            calls.append(words)
            if len(calls) == 2:
                raise KeyboardInterrupt
            original(*words)

        return write

    monkeypatch.setattr(import_module, "_write", stop(import_module._write))
    assert hd("import", source, "--map", mapping, "-o", tmp_path / "bag") == 130
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "robot.yaml"]


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("none.csv", None, "no such file"),
        ("log.xlsx", b"PK", "is not read; give a .csv or .npz file"),
        ("empty.csv", b"", "the file is empty"),
        ("head.csv", b"t,q_a1\n", "no row of numbers"),
        ("numbers.csv", b"1,2\n3,4\n", "line 1: expected the names of the columns"),
        ("ragged.csv", b"t,q_a1\n1,2\n3\n", "line 3: 1 cells, the header has 2"),
        ("words.csv", b"t,q_a1\n1,2\n3,fast\n", "line 3: 'fast' is not a number"),
        ("twice.csv", b"t,t\n1,2\n", "two columns are named 't'"),
        ("binary.csv", b"\xff\xfe\x00\x01", "not a readable CSV file"),
        ("broken.npz", b"PK\x03\x04nothing", "not a readable NPZ file"),
        ("other.csv", b"t,speed\n" + b"1,2\n" * 20, "no column 'q_a1'; there is t, speed"),
    ],
)
def test_bad_tables_are_one_line(tmp_path: Path, mapping: Path, capsys, name: str, content, says: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert hd("import", tmp_path / name, "--map", mapping, "-o", tmp_path / "bag") == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not (tmp_path / "bag").exists()


def test_a_foreign_table_without_a_mapping_says_so(tmp_path: Path, capsys) -> None:
    assert hd("import", write_csv(tmp_path / "log.csv", table()), "-o", tmp_path / "bag") == 2
    assert "a foreign table needs --map" in capsys.readouterr().err
    np.savez(tmp_path / "objects.npz", q=np.array([{}, {}], dtype=object))
    assert hd("import", tmp_path / "objects.npz", "-o", tmp_path / "bag") == 2
    assert "not a readable NPZ file" in capsys.readouterr().err


def test_an_export_needs_an_ending_it_knows(tmp_path: Path, capsys) -> None:
    assert hd("export", tmp_path / "bag", "-o", tmp_path / "out.mat") == 2
    assert "must end in .csv, .npz or .xml" in capsys.readouterr().err
