"""The thread that writes black boxes: outside the loop, again when the disk refuses, never the end of a node."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger

from hd_control.chain.black_box import BlackBox
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.nodes import stop_services
from hd_control.nodes.stop_services import BlackBoxService
from hd_control.record.black_box_files import black_boxes
from hd_control.record.reader import BagReader

STOP = Fault(FaultCode.SPIKE, 0, 1.0, 0.5, Action.CONTROLLED_STOP)


@pytest.fixture
def bench(tmp_path):
    """A service with one box of 301 rows that belongs to a node with parameters."""
    box, numbers = BlackBox(0.01), np.zeros(1)
    box.watch(("a",), numbers, {("motor_torque_command", "effort"): slice(0, 1)})
    values = {"black_box": True, "black_box_folder": str(tmp_path), "law": "adaptive"}
    robot = SimpleNamespace(urdf="<robot/>")
    node = SimpleNamespace(values=values, run_id="f" * 16, dt_ns=10_000_000, robot=robot)
    node.get_fully_qualified_name = lambda: "/arm/torque_node"
    service = BlackBoxService(node, lambda: {"": box})
    yield SimpleNamespace(box=box, node=node, service=service, folder=tmp_path / "arm" / "torque_node", tick=0)
    service._ending.set()


def run(bench, ticks, cause=None):
    for _ in range(ticks):
        bench.box.note(bench.tick, cause)
        bench.tick += 1


def answer(bench):
    found = bench.service.answer(None, Trigger.Response())
    return found.success, found.message


def until(condition):
    end = time.monotonic() + 20.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_a_stop_is_written_by_the_thread_with_parameters_and_robot(bench):
    run(bench, 300), run(bench, 150, STOP)
    until(lambda: bench.service.written == 1)
    [path] = black_boxes(bench.folder)
    assert bench.service.values() == {
        "black_boxes_written": 1, "black_box": str(path), "black_boxes_in_memory": 0, "black_box_failure": "",
    }  # fmt: skip
    bag = BagReader(path)
    assert bag.counts["/motor_torque_command"] == 301 and bag.complete
    assert {"robot.urdf", "torque_node.yaml"} <= set(bag.attachments)
    assert answer(bench) == (True, str(path))


def test_a_disk_that_refuses_keeps_it_in_memory_until_it_is_fetched(bench, tmp_path):
    (tmp_path / "full").write_text("a file where a folder ought to be")
    bench.node.values["black_box_folder"] = str(tmp_path / "full")
    run(bench, 300), run(bench, 150, STOP)
    granted, text = answer(bench)
    assert not granted and text.startswith("1 black boxes stay in memory:") and "full" in text
    assert bench.service.values()["black_box_failure"] != "" and bench.service.values()["black_boxes_in_memory"] == 1
    bench.node.values["black_box_folder"] = str(tmp_path)
    assert answer(bench) == (True, str(bench.folder / "000001_HD-F05"))
    assert bench.service.values()["black_box_failure"] == ""


def test_switched_off_they_stay_in_memory(bench):
    bench.node.values["black_box"] = False
    run(bench, 300), run(bench, 150, STOP)
    assert answer(bench) == (False, "1 black boxes stay in memory: parameter black_box is false")
    assert not bench.folder.exists()


def test_without_further_ticks_it_is_written_after_a_while_as_it_is(bench, monkeypatch):
    monkeypatch.setattr(stop_services, "SILENCE", 0.05)
    run(bench, 30), run(bench, 5, STOP)
    until(lambda: bench.service.written == 1)
    assert BagReader(black_boxes(bench.folder)[0]).counts["/motor_torque_command"] == 35


def test_the_end_of_the_node_writes_what_is_there_and_no_stop_is_no_box(bench):
    assert answer(bench) == (True, "no stop yet")
    run(bench, 30), run(bench, 5, STOP)
    bench.service.stop()
    assert len(black_boxes(bench.folder)) == 1 and not bench.service._thread.is_alive()


def test_an_exception_while_writing_is_reported_and_does_not_end_the_thread(bench, monkeypatch):
    def broken(*_):
        raise RuntimeError("no such thing")

    monkeypatch.setattr(stop_services, "write_incident", broken)
    run(bench, 300), run(bench, 150, STOP)
    until(lambda: "no such thing" in bench.service.failure)
    assert bench.service._thread.is_alive() and bench.service.values()["black_boxes_in_memory"] == 1
