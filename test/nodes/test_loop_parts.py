"""The parts of the loop that need no middleware: joining by tick, counting, plans of processes, imports."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hd_control import _plane
from hd_control._plane import AHEAD, COMPLETE, FOREIGN, OTHER_LAYOUT, REPEATED, STALE, STORED
from hd_control.chain.black_box import FaultBook
from hd_control.chain.chain import for_joints
from hd_control.core.errors import ConfigError
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.core.parameters import Parameter, ParameterSet, Shape
from hd_control.nodes.fast_loop import LoopStatistics, make_input, message_runs
from hd_control.record.cdr import JointStateCodec
from hd_control.session.session import RunPlan

ROOT = Path(__file__).resolve().parents[2]


NAMES = ("a", "b")
CODEC = JointStateCodec(NAMES, position=True)
PERIOD_NS = 1_000_000


class Inputs:
    """A join of some inputs, each with its own place to write to."""

    def __init__(self, count: int, optional: tuple[int, ...] = ()) -> None:
        self.join = _plane.Join(PERIOD_NS)
        self.numbers = np.zeros((count, len(NAMES)))
        for index in range(count):
            place = {"position": [(self.numbers[index], range(len(NAMES)))]}
            self.join.add(make_input(CODEC, place, index in optional))

    def offer(self, index: int, tick: int, run_id: str = "0" * 16) -> int:
        value = [tick, index]
        return self.join.offer(index, CODEC.encode(tick * PERIOD_NS, run_id, position=value))


def test_acts_only_on_complete_ticks() -> None:
    inputs = Inputs(2)
    assert inputs.offer(0, 5) == STORED and inputs.join.last_missing() == 1
    assert inputs.offer(1, 5) == COMPLETE and inputs.join.tick == 5
    np.testing.assert_array_equal(inputs.numbers, [[5, 0], [5, 1]])


def test_a_newer_tick_abandons_and_counts_an_incomplete_one() -> None:
    inputs = Inputs(2)
    inputs.offer(0, 1), inputs.offer(1, 1)
    inputs.offer(0, 2)
    inputs.offer(0, 3)
    assert inputs.join.incomplete == 1
    assert inputs.offer(1, 2) == STALE and inputs.join.stale == 1
    assert inputs.numbers[1, 0] == 1, "a message of the past writes nothing"
    assert inputs.offer(1, 3) == COMPLETE


def test_f02_a_stamp_that_stands_still_never_acts_again() -> None:
    inputs = Inputs(1)
    assert inputs.offer(0, 7) == COMPLETE
    assert inputs.offer(0, 7) == REPEATED


LEAP = 1000


def test_f44_one_message_from_the_future_does_not_leave_the_others_behind() -> None:
    inputs = Inputs(2)
    inputs.offer(0, 7), inputs.offer(1, 7)
    assert inputs.offer(0, 8 + LEAP) == AHEAD and inputs.join.ahead == 1 and inputs.join.tick == 7
    assert inputs.numbers[0, 0] == 7, "it writes nothing"
    assert inputs.offer(0, 8) == STORED and inputs.offer(1, 8) == COMPLETE
    assert inputs.offer(0, 10**9) == AHEAD and inputs.offer(0, 9) == STORED
    assert inputs.offer(1, 10**9) == AHEAD and inputs.offer(1, 9) == COMPLETE


def test_a_source_that_stood_still_for_long_goes_on_with_its_second_message() -> None:
    inputs = Inputs(2)
    inputs.offer(0, 7), inputs.offer(1, 7)
    assert inputs.offer(0, 90_000) == AHEAD and inputs.offer(1, 90_000) == AHEAD
    assert inputs.offer(0, 90_001) == STORED and inputs.offer(1, 90_001) == COMPLETE and inputs.join.tick == 90_001
    assert inputs.offer(0, 90_001 + LEAP) == STORED, "up to a second is an ordinary gap"
    assert inputs.offer(0, 90_001 + 2 * LEAP + 1) == AHEAD and inputs.offer(0, 90_000) == STALE
    assert inputs.offer(0, 90_001 + 2 * LEAP + 2) == AHEAD, "the message between them was of the right time"


def test_any_first_tick_is_taken() -> None:
    assert Inputs(1).offer(0, 2**40) == COMPLETE


def test_an_optional_input_counts_from_its_first_sight() -> None:
    inputs = Inputs(2, optional=(0,))
    assert inputs.offer(1, 1) == COMPLETE and not inputs.join.seen(0)
    assert inputs.offer(0, 2) == STORED and inputs.join.seen(0)
    assert inputs.offer(1, 2) == COMPLETE
    assert inputs.offer(1, 3) == STORED, "after it was seen, it is waited for"


def test_f19_f24_another_run_id_is_foreign_and_another_layout_is_named() -> None:
    inputs = Inputs(1)
    inputs.offer(0, 1)
    assert inputs.offer(0, 2, run_id="1" * 16) == FOREIGN and inputs.numbers[0, 0] == 1
    other = JointStateCodec(("a", "c"), position=True).encode(2 * PERIOD_NS, "0" * 16, position=[2, 2])
    assert inputs.join.offer(0, other) == OTHER_LAYOUT and inputs.numbers[0, 0] == 1


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 20)), max_size=60))
def test_any_interleaving_joins_equal_ticks_in_rising_order(messages: list[tuple[int, int]]) -> None:
    inputs, acted = Inputs(3), []
    for index, tick in messages:
        if inputs.offer(index, tick) == COMPLETE:
            assert (inputs.numbers[:, 0] == tick).all() and (inputs.numbers[:, 1] == [0, 1, 2]).all()
            acted.append(tick)
    assert acted == sorted(set(acted))


@given(st.binary(max_size=400), st.integers(0, 8))
def test_any_bytes_are_refused_without_a_trace(data: bytes, cut: int) -> None:
    inputs = Inputs(1)
    whole = CODEC.encode(PERIOD_NS, "0" * 16, position=[1, 2])
    for bad in (data, whole[: len(whole) - 1 - cut], whole + bytes(9 + cut)):
        assert inputs.join.offer(0, bad) == OTHER_LAYOUT
    assert (inputs.numbers == 0).all()


def test_a_compiled_message_is_the_codecs_message() -> None:
    numbers = np.array([9.0, 1.5, -2.5, 7.0])
    runs = message_runs(CODEC, {"position": numbers[1:3]})
    message = _plane.Message(CODEC.encode(0, "f" * 16), CODEC.stamp_place, runs)
    for stamp_ns in (0, 1_234_567_890_123, 2_000_000_000_000_000_000):
        assert message.fill(stamp_ns) == CODEC.encode(stamp_ns, "f" * 16, position=numbers[1:3])


def test_gaps_in_the_tick_count_as_missed() -> None:
    statistics = LoopStatistics()
    for tick in (10, 11, 14, 15):
        statistics.tick(tick, tick * 1_000_000, tick * 1_000_000 + 50_000)
    found = statistics.summary()
    assert (found["ticks"], found["missed"]) == (4, 2)
    assert found["busy_p50_us"] == 50.0 and found["period_max_us"] == 3000.0


def test_statistics_of_a_full_ring_are_those_of_the_newest_ticks() -> None:
    statistics = LoopStatistics()
    for tick in range(20_000):
        statistics.tick(tick, tick * (1_000_000 if tick < 5000 else 2_000_000), 0)
    assert statistics.summary()["period_max_us"] == 2000.0


def test_faults_are_merged_and_the_first_stop_is_kept() -> None:
    book = FaultBook()
    report = Fault(FaultCode.TORQUE_LIMITED, 1, 5.0, 4.0, Action.REPORT)
    stop = Fault(FaultCode.NODE_KILLED, 2, 10.0, 10.0, Action.TORQUE_RAMP)
    book.note([report], 3)
    book.note([report, stop], 4)
    book.note([Fault(FaultCode.NODE_KILLED, 0, 11.0, 10.0, Action.TORQUE_RAMP)], 5)
    assert book.first_stop == stop and book.first_stop_tick == 4
    assert book.values(("a", "b", "c"))["HD-F37 torque_limited b"].startswith("2 times since tick 3")
    book.clear()
    assert book.headline(("a", "b", "c")) == ""


def test_the_plant_is_activated_last_and_a_bag_brings_the_recorder(tmp_path: Path) -> None:
    names = [process.node for process in RunPlan(bag=tmp_path / "bag", lockstep=True).processes()]
    assert names == ["recorder_node", "torque_node", "motion_node", "fusion_node", "plant_node"]


def test_one_torque_node_per_joint_group() -> None:
    processes = RunPlan(joint_groups=(("joint_1",), ("joint_2", "joint_3"))).processes()
    assert [p.node for p in processes][:2] == ["torque_node_1", "torque_node_2"]
    assert 'joints:=["joint_2", "joint_3"]' in processes[1].ros_arguments()


def test_shipped_lists_are_cut_to_the_robot_by_name() -> None:
    per_joint = Parameter("gain", "a gain", shape=Shape.PER_JOINT)
    names = Parameter("joint_names", "names", kind=str, shape=Shape.LIST)
    both = ParameterSet("x", (names, per_joint, Parameter("scale", "one number")))
    values = {"joint_names": ["a", "b", "c"], "gain": [1.0, 2.0, 3.0], "scale": 4.0}
    assert for_joints(values, both, ["c", "a"]) == {"joint_names": ["c", "a"], "gain": [3.0, 1.0], "scale": 4.0}
    assert for_joints(values, both, ["d"]) == values


def test_an_unknown_node_is_refused() -> None:
    with pytest.raises(ConfigError, match="no node 'torque'"):
        RunPlan(nodes=("torque",))


def test_only_the_loop_keeps_real_time():
    """The executor thread beside it goes back to ordinary scheduling: equals under SCHED_FIFO do not interrupt."""
    code = (
        "import os, threading\n"
        "from hd_control.nodes.process import leave_real_time, request_real_time\n"
        "request_real_time()\n"
        "seen = []\n"
        "def beside():\n"
        "    leave_real_time()\n"
        "    seen.append(os.sched_getscheduler(0))\n"
        "thread = threading.Thread(target=beside); thread.start(); thread.join()\n"
        "print(os.sched_getscheduler(0) == os.SCHED_FIFO, seen[0] == os.SCHED_OTHER)\n"
    )
    environment = {**os.environ, "HD_REAL_TIME": "auto"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    loop, beside = done.stdout.split()
    assert beside == "True"
    if loop == "False":
        pytest.skip("this user may not use SCHED_FIFO")


THREADS = """
import ctypes, os, threading
from hd_control.nodes.process import demote_middleware, request_real_time

PR_SET_NAME, end, kept = 15, threading.Event(), {}
print(any("SCHED_FIFO 40" in note for note in request_real_time()))

def named(name, ready):
    ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode(), 0, 0, 0)
    kept[name] = threading.get_native_id()
    ready.set()
    end.wait()

for name in ("dds.asyn.0.0", "dds.ev.0", "dds.udp.7410", "dds.shm.7412", "dds.shm.7411", "dds.udp.7413", "signals"):
    ready = threading.Event()
    threading.Thread(target=named, args=(name, ready)).start()
    ready.wait()
demoted = demote_middleware()
assert set(demoted) == {name for name, thread in kept.items() if os.sched_getscheduler(thread) == os.SCHED_OTHER}
print(" ".join(sorted(demoted)))
end.set()
"""


def test_of_the_middleware_only_receivers_of_data_keep_real_time():
    """Data ports of RTPS are odd, those of discovery even."""
    environment = {**os.environ, "HD_REAL_TIME": "auto"}
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, env=environment)
    if done.stdout.startswith("False"):
        pytest.skip("this user may not use SCHED_FIFO")
    assert done.stdout.split()[1:] == ["dds.asyn.0.0", "dds.ev.0", "dds.shm.7412", "dds.udp.7410"], done.stderr
