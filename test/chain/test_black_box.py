"""Black box: two seconds before each stop and one after it, as numbers and as a bag that the other commands read."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from fault_injection import FaultyRunner, Injection

from hd_control.chain.black_box import BlackBox
from hd_control.cli.main import main
from hd_control.core.errors import BagError
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.record import black_box_files
from hd_control.record.black_box_files import KEPT, Incident, Origin, black_boxes, write_incident
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import RunSetup

STOP = Fault(FaultCode.NODE_KILLED, 0, 10.0, 10.0, Action.CONTROLLED_STOP)
OTHER = Fault(FaultCode.SPIKE, 0, 1.0, 0.5, Action.CONTROLLED_STOP)
ORIGIN = Origin(
    "/torque_node", "0123456789abcdef", 1_000_000, "<robot/>", "/**:\n  ros__parameters:\n    law: adaptive\n"
)
COMMAND = "motor_torque_command"


def noted(stops, ticks, period=0.01):
    """A box of 200 + 1 + 100 rows after some ticks; `stops` are ranges of ticks in which the robot is stopped."""
    box, numbers = BlackBox(period), np.zeros(2)
    box.watch(("a", "b"), numbers, {(COMMAND, "effort"): slice(0, 2)})
    for tick in range(ticks):
        numbers[:] = tick, -tick
        cause = next((cause for first, last, cause in stops if first <= tick < last), None)
        box.note(tick, cause)
    return box


def test_two_seconds_before_and_one_after():
    box = noted([(500, 10_000, STOP)], 1000)
    [incident] = box.take()
    assert incident.stop_tick == 500 and incident.code == "HD-F18" and "input age 10 samples" in incident.text
    np.testing.assert_array_equal(incident.ticks, np.arange(300, 601))
    np.testing.assert_array_equal(
        incident.topics[COMMAND][1]["effort"], np.stack([np.arange(300, 601)] * 2, 1) * [1, -1]
    )
    assert box.take() == [] and box.incidents == 0


@pytest.mark.parametrize("ticks", [500, 601, 100_000])
def test_it_waits_for_the_second_after_the_stop_and_keeps_it_until_it_is_taken(ticks):
    """The ring is used again many times; what nobody has taken was copied before."""
    box = noted([(499, 10**9, STOP)], ticks)
    assert len(box.take()) == (ticks > 600) and box.waits == (ticks == 500)
    rest = box.take(all_of_them=True)
    assert len(rest) == (ticks == 500) and all(each.ticks[-1] == 499 for each in rest)


def test_a_second_stop_soon_after_a_reset_has_its_own_two_seconds():
    [first, second] = noted([(500, 520, STOP), (560, 10_000, OTHER)], 1000).take()
    assert (first.stop_tick, first.code, first.ticks[0], first.ticks[-1]) == (500, "HD-F18", 300, 600)
    assert (second.stop_tick, second.code, second.ticks[0], second.ticks[-1]) == (560, "HD-F05", 360, 660)


def test_a_stop_before_anything_was_seen_and_an_exception_without_a_further_tick():
    box = BlackBox(0.01)
    box.mark(ValueError("nothing yet"))
    [incident] = box.take(all_of_them=True)
    assert incident.code == "HD-F33" and "ValueError('nothing yet')" in incident.text and incident.ticks.size == 0
    early = noted([(3, 10_000, STOP)], 400)
    assert early.take()[0].ticks[0] == 0


def test_no_more_than_twenty_stay_in_memory_the_newest_of_them():
    stops = [(1000 * k, 1000 * k + 500, Fault(FaultCode.SPIKE, 0, k, 0.0, Action.TORQUE_RAMP)) for k in range(1, 31)]
    found = noted(stops, 31_500).take()
    assert len(found) == KEPT and [each.stop_tick for each in found] == [1000 * k for k in range(11, 31)]


def incident_of(tick):
    ticks = np.arange(tick - 5, tick + 5)
    return Incident(ticks, {COMMAND: (("a",), {"effort": np.ones((10, 1))})}, tick, "HD-F18", "why")


def test_twenty_are_kept_the_oldest_goes_and_nothing_else(tmp_path):
    """By number, not by time: a clock that has jumped does not matter. Strange names are left alone."""
    (tmp_path / "000001_mine").mkdir()
    (tmp_path / "notes.txt").write_text("x")
    for tick in range(100, 123):
        write_incident(tmp_path, incident_of(tick), ORIGIN)
    names = [path.name for path in black_boxes(tmp_path)]
    assert names == [f"{number:06d}_HD-F18" for number in range(4, 24)]
    assert (tmp_path / "000001_mine").is_dir() and (tmp_path / "notes.txt").exists()
    shutil.rmtree(tmp_path / "000023_HD-F18")
    assert write_incident(tmp_path, incident_of(50), ORIGIN).name == "000023_HD-F18"


@pytest.mark.parametrize("write_number", [1, 2, 3])
def test_a_disk_that_refuses_leaves_nothing_half_and_removes_nothing(tmp_path, monkeypatch, write_number):
    for tick in range(100, 100 + KEPT):
        write_incident(tmp_path, incident_of(tick), ORIGIN)
    before = sorted(path.name for path in tmp_path.iterdir())
    calls, guard = [], BagWriter._guard

    def failing(self, action):
        calls.append(1)

        def refuse():
            raise OSError(28, "No space left on device")

        guard(self, refuse if len(calls) >= write_number else action)

    monkeypatch.setattr(black_box_files.BagWriter, "_guard", failing)
    with pytest.raises(BagError, match="No space left"):
        write_incident(tmp_path, incident_of(500), ORIGIN)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_folder_that_cannot_be_made_is_one_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="file"):
        write_incident(tmp_path / "file" / "boxes", incident_of(9), ORIGIN)


def stopped_run(recorder):
    """A run that an exception stops at tick 2500, and the control side's incident."""
    runner = FaultyRunner(
        RunSetup(PlantConfig.from_file("single_joint_5"), 1), [Injection("torque", "exception", -1, 2500, 1, 1.0)], 1
    )
    codec = joint_state_codec(COMMAND, runner.robot.joint_names)
    for tick in range(3600):
        bus = runner.step()
        if recorder is not None:
            recorder.offer(COMMAND, tick * 10**6, codec.encode(tick * 10**6, "0" * 16, effort=bus[COMMAND]["effort"]))
            recorder.tend(tick * 10**6)
    [incident] = runner.torque.black_box.take()
    return runner, incident


def test_g19_every_signal_of_the_last_two_seconds_with_and_without_a_recorder(tmp_path, capsys):
    recorder = Recorder(BagWriter(tmp_path / "recording"))
    recorder.add_topic(COMMAND)
    runner, with_recorder = stopped_run(recorder)
    _, without = stopped_run(None)
    assert recorder.close() == ""
    # The exception came before tick 2500: its row is the newest of that moment.
    assert (without.stop_tick, without.ticks[0], without.ticks[-1], len(without.ticks)) == (2499, 499, 3499, 3001)
    for topic, (_, arrays) in without.topics.items():
        for name, table in arrays.items():
            np.testing.assert_array_equal(table, with_recorder.topics[topic][1][name])
    path = write_incident(tmp_path / "boxes", without, Origin("/chain", "f" * 16, 10**6, runner.robot.urdf, "a: 1\n"))
    assert main(["info", str(path), "--json", str(tmp_path / "info.json")]) == 0
    assert "black box of /chain, stopped in tick 2499: HD-F33 exception: Injected" in capsys.readouterr().out
    said = json.loads((tmp_path / "info.json").read_text())
    assert "HD-F33 exception" in said["session"]["stop"] and "Traceback" in said["session"]["stop"]
    bag = BagReader(path)
    expected = {"encoder", "resolver", "gauge_bridge", "motor_torque_applied", "joint_states", "motor_states",
                "joint_reference", "joint_torque_required", COMMAND}  # fmt: skip
    assert expected <= {topic.strip("/") for topic in bag.counts}
    recorded, kept = BagReader(tmp_path / "recording").columns(COMMAND), bag.columns(COMMAND)
    np.testing.assert_array_equal(kept.values["effort"], recorded.values["effort"][499:3500])
    assert np.abs(kept.values["effort"]).max() > 1.0


def test_the_raw_reading_is_kept_not_what_a_monitor_made_of_it(tmp_path):
    fault = Injection("encoder", "not_finite", -1, 700, 50, 1.0)
    runner = FaultyRunner(RunSetup(PlantConfig.from_file("single_joint_5"), 1), [fault], 1)
    for _ in range(900):
        runner.step()
    [incident] = runner.torque.black_box.take(all_of_them=True)
    first = int(np.flatnonzero(~np.isfinite(incident.topics["encoder"][1]["position"][:, 0]))[0])
    assert incident.ticks[first] == 700 and incident.stop_tick == 702


def test_hd_compare_reads_a_black_box(tmp_path, capsys):
    runner = FaultyRunner(
        RunSetup(PlantConfig.from_file("single_joint_5"), 1), [Injection(COMMAND, "off", -1, 2500, 2000, 1.0)], 1
    )
    for _ in range(4000):
        runner.step()
    [drive] = runner.world.black_box.take()
    path = write_incident(tmp_path, drive, Origin("/plant_node", "f" * 16, 10**6, runner.robot.urdf, "a: 1\n"))
    code = main(["compare", str(path), "--model", "single_joint_5"])
    said = capsys.readouterr()
    assert code == 0, said.err
    assert Path(path).name == "000001_HD-F18"
