"""The recorder's ways in: a compiled thread, or a loop in Python, take the same and count the same."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt64

from hd_control.nodes import recorder_node
from hd_control.nodes.fast_loop import HandsOff, chain_qos, latched_qos
from hd_control.nodes.process import DATA_RECEIVER, RECEIVING_PRIORITY, prepare_environment
from hd_control.nodes.recorder_node import NEEDED, LoopTaking, PumpTaking, RecordedTopic, Taking, taking_of
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_control.session.session import child_environment

TICK, RUN, DEPTH = 1_000_000, "0123456789abcdef", 200
EXTRA = ("robot_description",)
LIMIT = 20.0
"""s that only a defect needs."""


def until(true: Callable[[], Any]) -> bool:
    end = time.monotonic() + LIMIT
    while not (found := true()) and time.monotonic() < end:
        time.sleep(0.002)
    return bool(found)


class Bench:
    """Publishers and recorded topics of one process, in a domain of its own."""

    def __init__(self, folder: Path, reliable: bool = True) -> None:
        self.folder, self.node, self.number = folder, rclpy.create_node("bench"), 0
        self.codecs = {name: joint_state_codec(name, ("a", "b")) for name in NEEDED}
        self.publishers = {name: self.node.create_publisher(JointState, name, chain_qos(DEPTH)) for name in NEEDED}
        self.texts = self.node.create_publisher(String, EXTRA[0], latched_qos())
        self.progress = self.node.create_publisher(UInt64, "recorder/progress", chain_qos(DEPTH))
        self.heard = self.node.create_subscription(UInt64, "recorder/progress", lambda _: None, chain_qos(DEPTH))
        self.topics = [RecordedTopic(self.node, name, DEPTH, HandsOff(), reliable) for name in (*NEEDED, *EXTRA)]
        ends = [topic.subscription.handle for topic in self.topics]
        assert until(lambda: all(end.get_publisher_count() for end in ends))
        assert until(lambda: all(publisher.get_subscription_count() for publisher in self.publishers.values()))
        assert until(self.progress.get_subscription_count)

    def recorder(self) -> Recorder:
        """A new recorder of all topics."""
        self.number += 1
        recorder = Recorder(BagWriter(self.folder / f"bag_{self.number}", compact=False))
        for topic in self.topics:
            recorder.add_topic(topic.path)
        return recorder

    def publish(self, name: str, tick: int) -> None:
        """The message of a tick; its numbers are the tick."""
        codec = self.codecs[name]
        arrays = dict.fromkeys(codec.fields, np.full(2, float(tick)))
        self.publishers[name].handle.publish_raw(codec.encode(tick * TICK, RUN, **arrays))

    def reports(self) -> list[int]:
        """The progress that was published since the last call."""
        found = []
        while (taken := self.heard.handle.take_message(UInt64, False)) is not None:
            found.append(taken[0].data)
        return found


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    prepare_environment()
    arguments = ["--ros-args", "--log-level", "error"]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=1 + secrets.randbelow(100))
    found = Bench(tmp_path)
    yield found
    found.node.destroy_node()
    rclpy.shutdown()


def pump(bench: Bench) -> Taking:
    return PumpTaking(bench.topics, TICK, bench.progress, False)


def resting_pump(bench: Bench) -> Taking:
    return PumpTaking(bench.topics, TICK, bench.progress, True)


def loop(bench: Bench) -> Taking:
    return LoopTaking(bench.topics, TICK, bench.progress, "for this test")


every_way = pytest.mark.parametrize("way", [pump, resting_pump, loop], ids=lambda way: way.__name__)


def received(taking: Taking, recorder: Recorder, topic: str) -> int:
    taking.collect()
    return int(recorder.statistics()[f"/{topic}"]["received"])


@every_way
def test_every_message_is_in_the_bag_once(bench: Bench, way: Callable[[Bench], Taking]) -> None:
    taking, recorder = way(bench), bench.recorder()
    recorder.write_beside()
    taking.record(recorder)
    bench.texts.publish(String(data="<robot/>"))
    for tick in range(300):
        for name in NEEDED:
            bench.publish(name, tick)
        if tick % 50 == 0:
            assert until(lambda tick=tick: received(taking, recorder, NEEDED[0]) == tick + 1)
    for name in NEEDED:
        assert until(lambda name=name: received(taking, recorder, name) == 300)
    assert until(lambda: received(taking, recorder, EXTRA[0]) == 1)
    taking.record(None)
    taking.end()
    assert recorder.close() == ""
    reader = BagReader(recorder.bag.path)
    assert reader.complete and reader.problems == []
    for name in NEEDED:
        columns = reader.columns(name)
        assert np.array_equal(columns.stamps_ns, TICK * np.arange(300))
        assert (np.diff(columns.log_times_ns) >= 0).all() and abs(time.time_ns() - columns.log_times_ns[0]) < 600e9
        assert np.array_equal(columns.values[next(iter(bench.codecs[name].fields))][:, 0], np.arange(300.0))
        assert not any(reader.accounting[f"/{name}"]["drops"].values())
    assert [text.data for _, text in reader.messages(EXTRA[0])] == ["<robot/>"]


@every_way
def test_lost_on_the_way_and_never_published_are_kept_apart(bench: Bench, way: Callable[[Bench], Taking]) -> None:
    """The middleware keeps 5 messages for the recorder, 1000 are sent at once: what is not taken in time is lost on the
    way, each one counted. The publisher then leaves out 7 ticks: never published."""
    bench.topics = [RecordedTopic(bench.node, "encoder", 5, HandsOff(), True)]
    assert until(bench.topics[0].subscription.handle.get_publisher_count)
    assert until(lambda: bench.publishers["encoder"].get_subscription_count() == 2)
    taking, recorder = way(bench), bench.recorder()
    taking.record(recorder)
    bench.publish("encoder", 0)
    assert until(lambda: received(taking, recorder, "encoder") == 1)
    for tick in range(1, 1000):
        bench.publish("encoder", tick)
    assert until(lambda: received(taking, recorder, "encoder") and recorder.newest_ns == 999 * TICK)
    bench.publish("encoder", 1007)
    assert until(lambda: received(taking, recorder, "encoder") and recorder.newest_ns == 1007 * TICK)
    taking.record(None)
    taking.end()
    assert recorder.close() == ""
    row = recorder.statistics()["/encoder"]
    lost = row["drops"]["transport"]
    assert lost > 0 and row["received"] + lost == row["published"] == 1001
    assert (row["never_published"], row["missing"]) == (7, 7 + lost)
    assert BagReader(recorder.bag.path).accounting["/encoder"]["never_published"] == 7


@every_way
def test_the_slowest_topic_is_reported(bench: Bench, way: Callable[[Bench], Taking]) -> None:
    taking, recorder = way(bench), bench.recorder()
    taking.record(recorder)

    def reported() -> list[int]:
        taking.collect()
        taking.report(recorder)
        return bench.reports()

    for name in NEEDED[:-1]:
        bench.publish(name, 300)
    assert until(lambda: received(taking, recorder, NEEDED[-2]) == 1) and reported() == []
    bench.publish(NEEDED[-1], 120)
    assert until(lambda: reported() == [120])
    bench.publish(NEEDED[-1], 310)
    assert until(lambda: reported() == [300])
    time.sleep(0.05)
    assert reported() == [], "each tick once"
    taking.record(None)
    taking.end()
    recorder.close()


@every_way
def test_nothing_goes_to_a_recorder_after_its_end(bench: Bench, way: Callable[[Bench], Taking]) -> None:
    """What comes between two recordings is in neither."""
    taking, first = way(bench), bench.recorder()
    taking.record(first)
    bench.publish("encoder", 1)
    assert until(lambda: received(taking, first, "encoder") == 1)
    taking.record(None)
    bench.publish("encoder", 2)
    assert until(lambda: taking.collect() == 1), "taken and thrown away"
    second = bench.recorder()
    taking.record(second)
    bench.publish("encoder", 3)
    assert until(lambda: received(taking, second, "encoder") == 1)
    taking.end()
    for recorder, tick in ((first, 1), (second, 3)):
        assert recorder.close() == ""
        assert BagReader(recorder.bag.path).columns("encoder").stamps_ns.tolist() == [tick * TICK]


def test_a_message_that_no_reader_takes_is_refused_by_the_pump(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hd_control.record.recorder.LONGEST_RECORD", 2_000_000)
    taking, recorder = pump(bench), bench.recorder()
    taking.record(recorder)
    for length in (1_500_000, 3_000_000, 10):
        bench.texts.publish(String(data="x" * length))
        assert until(lambda: received(taking, recorder, EXTRA[0]) >= 1)
        time.sleep(0.1)
    taking.end()
    assert recorder.close() == ""
    row = recorder.statistics()[f"/{EXTRA[0]}"]
    assert (row["written"], row["drops"]["size"]) == (2, 1)
    assert [len(text.data) for _, text in BagReader(recorder.bag.path).messages(EXTRA[0])] == [1_500_000, 10]


@pytest.mark.parametrize("way", [pump, resting_pump], ids=lambda way: way.__name__)
def test_beginning_and_ending_under_traffic(bench: Bench, way: Callable[[Bench], Taking]) -> None:
    """Made, begun, ended and destroyed again and again while messages arrive; 30 times here, HD_STRESS times if set."""
    ended = threading.Event()

    def traffic() -> None:
        tick = 0
        while not ended.is_set():
            tick += 1
            for name in NEEDED:
                bench.publish(name, tick)

    thread = threading.Thread(target=traffic)
    thread.start()
    try:
        for number in range(int(os.environ.get("HD_STRESS", "30"))):
            topics = [RecordedTopic(bench.node, name, DEPTH, HandsOff(), number % 2 == 0) for name in NEEDED]
            recorder = Recorder(BagWriter(bench.folder / f"stress_{number}", compact=False))
            for topic in topics:
                recorder.add_topic(topic.path)
            bench.topics, kept = topics, bench.topics
            taking = way(bench)
            bench.topics = kept
            recorder.write_beside()
            taking.record(recorder)
            taking.report(recorder)
            time.sleep(0.005 * (number % 4))
            if number % 3 == 0:
                for topic in topics:
                    bench.node.destroy_subscription(topic.subscription)
            taking.record(None)
            assert recorder.close() == ""
            taking.end()
            if number % 3:
                for topic in topics:
                    bench.node.destroy_subscription(topic.subscription)
            table = recorder.statistics()
            assert all(row["received"] == row["written"] + row["drops"]["queue"] for row in table.values())
    finally:
        ended.set()
        thread.join()


def test_where_the_pump_cannot_be_used_python_takes(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(found := taking_of(bench.topics, TICK, bench.progress, True), PumpTaking)
    found.end()

    def refuse(dt_ns: int) -> None:
        raise RuntimeError("the loaded ROS 2 is another one")

    monkeypatch.setattr(recorder_node, "Pump", refuse)
    found = taking_of(bench.topics, TICK, bench.progress, True)
    assert isinstance(found, LoopTaking) and found.how == "in Python (the loaded ROS 2 is another one)"


def test_only_the_chain_goes_without_answers(tmp_path: Path, bench: Bench) -> None:
    """On the wall clock the control nodes need not answer the recorder; events are asked for again always."""
    kinds = {topic.name: topic for topic in bench.topics}
    paced = [RecordedTopic(bench.node, name, DEPTH, HandsOff(), False) for name in (*NEEDED, *EXTRA)]
    levels = {topic.name: topic.subscription.qos_profile.reliability.name for topic in paced}
    assert levels == {**dict.fromkeys(NEEDED, "BEST_EFFORT"), EXTRA[0]: "RELIABLE"}
    assert {topic.subscription.qos_profile.reliability.name for topic in kinds.values()} == {"RELIABLE"}


@pytest.mark.process
def test_only_receiving_threads_of_the_recorder_have_real_time(tmp_path: Path) -> None:
    """Below the control loops, above ordinary programs: while they stand still their queue in shared memory runs over.
    So has what takes, for they share locks. Writing and everything in Python are ordinary."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))"
    if subprocess.run([sys.executable, "-c", code], capture_output=True).returncode:
        pytest.skip("this user may not use SCHED_FIFO")
    command = [sys.executable, "-m", "hd_control.nodes.recorder_node", "--ros-args", "-p", "autostart:=true"]
    environment = child_environment(1 + secrets.randbelow(100)) | {"HD_REAL_TIME": "auto"}
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(
            [*command, "-p", f"bag:={tmp_path}/bag"], env=environment, stdout=log, stderr=log, cwd=tmp_path
        )

    def policies() -> dict[str, tuple[int, int]]:
        found = {}
        for thread in Path(f"/proc/{process.pid}/task").iterdir():
            number = int(thread.name)
            name = (thread / "comm").read_text().strip()
            found[name] = os.sched_getscheduler(number), os.sched_getparam(number).sched_priority
        return found

    try:
        assert until(lambda: {"hd.take", "hd.write"} <= set(policies())), (tmp_path / "log").read_text()
        found = policies()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
    receiving = {name for name in found if DATA_RECEIVER.fullmatch(name)} | {"hd.take"}
    assert len(receiving) > 1 and {found[name] for name in receiving} == {(os.SCHED_FIFO, RECEIVING_PRIORITY)}
    assert {found[name] for name in set(found) - receiving} == {(os.SCHED_OTHER, 0)}
