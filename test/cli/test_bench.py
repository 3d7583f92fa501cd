"""hd bench: the schema, peers under the names of our rows, growth as points and as a picture, pages made from them."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from hd_control.bench import commands, growth, rows
from hd_control.bench.growth import FIELDS, Point, growth_figure
from hd_control.bench.measure import Timed, summarise, time_each
from hd_control.bench.recording import recorder_run
from hd_control.cli import bench
from hd_control.cli.main import main
from hd_control.core.errors import HdError
from hd_control.pages import pages

NAMES = set(
    "plant_5_substeps plant_10_substeps step_fusion step_motion step_torque step_gate chain_compute lockstep_pure "
    "lockstep_ros_ticks ring_p50 ring_p99 ring_missed one_process_p50 decode_messages compare_bag diagnose_joint "
    "peak_memory_compare cli_start replay_batch recorder_share recorder_lost recorder_loaded_share "
    "recorder_loaded_lost".split()
)
ROW = {"name", "median", "min", "p99", "unit", "runs", "peer"}


def test_a_run_has_the_schema_and_peers_beside_our_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bench.json"
    assert main(["bench", "--only", "plant", "laws", "--runs", "1", "--json", str(file)]) == 0
    document = json.loads(file.read_text())
    assert document["schema"] == "hd.bench/1" and {"cpu", "cores", "system", "python", "load"} <= set(
        document["machine"]
    )
    assert all(set(row) == ROW and row["median"] > 0.0 for row in document["results"])
    beside = {row["peer"] for row in document["results"] if row["name"] == "plant_5_substeps"}
    assert {None, "numpy"} <= beside
    assert "machine: cpu" in capsys.readouterr().out


def test_every_row_of_the_interface_is_in_the_stored_run() -> None:
    document = json.loads(pages.FILE.read_text())
    assert {row["name"] for row in document["results"] if row["peer"] is None} >= NAMES
    assert set(pages.MEANINGS) >= NAMES
    peers = {(row["name"], row["peer"]) for row in document["results"] if row["peer"]}
    assert {("ring_p50", "stock_executor"), ("decode_messages", "rosbags_raw"), ("plant_5_substeps", "mujoco")} <= peers


def test_live_rows_have_a_bare_loop_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    from hd_control.bench import robot

    asked: list[tuple[str, bool]] = []

    def run(form: str, seconds: float, loaded: bool) -> robot.LiveResult:
        asked.append((form, loaded))
        return robot.LiveResult(250.0, 400.0, 0.5, 0.125, form == "per_joint")

    monkeypatch.setattr(robot, "live_run", run)
    found = {(row.name, row.peer): row.median for row in rows.robot_rows(2, 1.0, True)}
    assert found["robot_ring_loaded_missed", None] == 0.5 and found["robot_ring_loaded_missed", "bare_loop"] == 0.125
    assert found["per_joint_stopped", None] == 1.0 and found["one_process_p50", None] == 250.0
    assert set(asked) == {(form, loaded) for form in robot.FORMS for loaded in (False, True)} and len(asked) == 16
    assert {name for name, _ in found} <= set(pages.MEANINGS)
    assert {row.name for row in rows.robot_rows(1, 1.0, False)} < {name for name, _ in found}


def test_every_form_of_a_live_run_names_its_processes(tmp_path: Path) -> None:
    from hd_control.bench import robot

    count = {form: len(make(tmp_path).processes()) for form, make in robot.FORMS.items()}
    assert count == {"four": 5, "per_joint": 11, "one": 1, "one_4khz": 1}
    text = (tmp_path / "arm_4khz.yaml").read_text()
    assert f"period: {robot.FAST_PERIOD}" in text and f"substeps_per_ms: {robot.FAST_SUBSTEPS}" in text


def test_the_bare_loop_counts_every_millisecond_and_a_late_one() -> None:
    from hd_control import _plane

    late = _plane.bare_loop(100_000, 50)
    assert late.shape == (50,) and (late >= 0).all(), "a thread never wakes too early"
    command = [sys.executable, "-m", "hd_control.bench.robot", "0.02"]
    found = subprocess.run(command, capture_output=True, check=True, timeout=60.0)
    assert 0.0 <= json.loads(found.stdout) <= 100.0
    with pytest.raises(ValueError, match="period"):
        _plane.bare_loop(0, 1)


def test_bad_numbers_are_refused_before_any_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--runs", "0"]) == 2 and "positive" in capsys.readouterr().err


def test_processor_time_is_counted_per_unit_of_work() -> None:
    calls = []
    (row,) = time_each("x", "us", [Timed(lambda: calls.append(sum(range(20_000))), 10)], 3)
    assert len(calls) == 4 and row.runs == 3 and 0.0 < row.min <= row.median <= row.p99


def test_lines_show_ratios_and_what_was_not_measured() -> None:
    rows = [summarise("a", "us", [2.0]), summarise("a", "us", [6.0], "other"), summarise("b", "us", [math.nan])]
    text = list(bench.lines(rows))
    assert text[1].endswith("3 x") and "-" in text[2]


def test_a_command_that_fails_is_reported_with_its_words() -> None:
    with pytest.raises(HdError, match="no such"):
        commands.run_hd("info", "/nowhere/at/all")


def test_growth_is_printed_stored_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = [Point("replay_tick", "joints", n, 100.0 * n, "us CPU") for n in (1, 7)]
    monkeypatch.setattr(growth, "growth_points", lambda curves, seconds, notes: iter(points))
    file = tmp_path / "bench.json"
    assert main(["bench", "--only", "laws", "--runs", "1", "--growth", "--json", str(file)]) == 0
    stored = json.loads(file.read_text())["growth"]
    assert stored == [point.as_json() for point in points]
    figure = growth_figure(stored)
    assert figure["data"][0]["y"] == [1.0, 7.0] and figure["data"][0]["x"] == [1, 7]


def test_every_stored_curve_grows_over_something_and_is_drawn_or_listed() -> None:
    stored = json.loads(pages.FILE.read_text())["growth"]
    names = {point["name"] for point in stored}
    drawn = {trace["name"].split(" (")[0] for trace in growth_figure(stored)["data"]}
    assert drawn <= {name for _, curves in FIELDS for name in curves} & names
    assert all(f"`{name}`" in pages.bench_page() for name in names)
    assert all(len({point["size"] for point in stored if point["name"] == name}) > 1 for name in names)


def test_an_interrupted_run_keeps_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(curves, seconds: float, notes: list[str]):
        yield Point("replay_tick", "joints", 1, 100.0, "us CPU")
        raise KeyboardInterrupt

    monkeypatch.setattr(growth, "growth_points", interrupted)
    file = tmp_path / "bench.json"
    assert main(["bench", "--only", "laws", "--runs", "1", "--growth", "--json", str(file)]) == 130
    document = json.loads(file.read_text())
    assert len(document["growth"]) == 1 and len(document["results"]) == 5


def test_what_cannot_be_measured_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(runs: int):
        raise HdError("no room for four processes")

    monkeypatch.setattr(rows, "start_rows", failing)
    file = tmp_path / "bench.json"
    assert main(["bench", "--only", "start", "laws", "--runs", "1", "--json", str(file)]) == 0
    document = json.loads(file.read_text())
    assert document["notes"] == ["start: not measured, no room for four processes"] and len(document["results"]) == 5


def test_an_update_keeps_what_is_not_measured_again(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    words = ["bench", "--runs", "1", "--json", str(file)]
    assert main([*words, "--only", "laws"]) == 0
    assert main([*words, "--only", "start", "--update", "--force"]) == 0
    document = json.loads(file.read_text())
    assert [row["name"] for row in document["results"]][-1] == "cli_start" and len(document["results"]) == 6
    assert "step_fusion" in document["notes"][0] and "earlier run" in document["notes"][0]
    file.write_text("{}")
    assert main([*words, "--only", "start", "--update", "--force"]) == 2


@pytest.mark.process
def test_a_recording_is_measured_from_outside() -> None:
    """All ticks of eleven topics are published, and what is lost is the difference to what a reader finds."""
    run = recorder_run(1.0)
    assert run.published % 11 == 0 and run.published >= 11 * 500
    assert run.share > 0.0 and 0 <= run.lost < run.published
