"""The recorder as a process of its own under traffic: stopped, interrupted, killed, with queues that are too short.

Whatever happens: published = written + reported drops, to the sample, and what the bag holds is readable.
"""

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
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt64

from hd_control.nodes.fast_loop import chain_qos, latched_qos
from hd_control.nodes.process import prepare_environment
from hd_control.nodes.recorder_node import NEEDED
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.session.session import Children, child_environment

LIMIT = 30.0
STOPPED = float(os.environ.get("HD_STOPPED", "0.7"))
"""s of SIGSTOP."""


def until(true: Callable[[], Any]) -> bool:
    end = time.monotonic() + LIMIT
    while not (found := true()) and time.monotonic() < end:
        time.sleep(0.005)
    return bool(found)


class Robot:
    """What a recorder waits for, published a thousand times a second from a thread; stamps are wall times."""

    def __init__(self, space: str, qos: QoSProfile) -> None:
        self.node = rclpy.create_node("robot", namespace=space)
        self.codecs = {name: joint_state_codec(name, ("a", "b")) for name in NEEDED}
        self.ends = {name: self.node.create_publisher(JointState, name, qos) for name in NEEDED}
        self.progress = self.node.create_subscription(UInt64, "recorder/progress", lambda _: None, latched_qos())
        self.published, self.first_ns = 0, 0
        self._running = False
        self._thread: threading.Thread | None = None

    def ready(self) -> bool:
        """The recorder says that it hears everybody."""
        return self.progress.handle.take_message(UInt64, False) is not None

    def start(self) -> None:
        self._running = True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> None:
        self._running = False
        if self._thread is not None:
            self._thread.join()

    def publish(self) -> None:
        """One tick after the other: none is left out."""
        self.first_ns = self.first_ns or time.time_ns()
        stamp = self.first_ns + self.published * 1_000_000
        for name, codec in self.codecs.items():
            values = dict.fromkeys(codec.fields, np.full(2, float(self.published)))
            self.ends[name].handle.publish_raw(codec.encode(stamp, "0123456789abcdef", **values))
        self.published += 1

    def _run(self) -> None:
        while self._running:
            while self._running and time.time_ns() > self.first_ns + self.published * 1_000_000:
                self.publish()
            time.sleep(0.0005)


class Stand:
    """A recorder process and a robot beside it, in a name space that no other run has."""

    def __init__(self, folder: Path, children: Children, domain: int, qos: QoSProfile, *more: str) -> None:
        self.children, self.space = children, f"/robot_{secrets.token_hex(4)}"
        self.bag, self.log, self.domain = folder / "bag", folder / "log", domain
        named = ("autostart:=true", f"bag:={self.bag}", "compact:=false", *more)
        command = [sys.executable, "-m", "hd_control.nodes.recorder_node", "--ros-args"]
        with self.log.open("wb") as log:
            parameters = [word for text in named for word in ("-p", text)]
            words = [*command, "-r", f"__ns:={self.space}", *parameters]
            self.recorder = children.start("recorder", words, stdout=log, stderr=log, cwd=folder)
        self.robot = Robot(self.space, qos)

    def begin(self) -> None:
        """Until the recorder is ready; the robot then runs for a while."""
        assert until(self.robot.ready), self.log.read_text()
        self.robot.start()
        self.run()

    def run(self, ticks: int = 200) -> None:
        """Until that many more ticks are published."""
        aim = self.robot.published + ticks
        assert until(lambda: self.robot.published >= aim)

    def end(self, number: int = signal.SIGINT) -> int:
        """The recorder's exit code after that signal."""
        self.recorder.send_signal(number)
        return self.recorder.wait(LIMIT)

    def balance(self) -> dict[str, dict[str, int]]:
        """The drops of each topic. With those everything that was published is in the bag; what is there is whole."""
        reader, drops = BagReader(self.bag), {}
        assert reader.complete
        for name in NEEDED:
            account = reader.accounting[f"{self.space}/{name}"]
            drops[name] = account["drops"]
            assert self.robot.published == account["written"] + sum(drops[name].values()), (name, account)
            columns = reader.columns(f"{self.space}/{name}")
            ticks = (columns.stamps_ns - self.robot.first_ns) // 1_000_000
            assert len(ticks) == account["written"] and (np.diff(ticks) > 0).all() and account["never_published"] == 0
        return drops


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Callable[..., Stand]]:
    prepare_environment()
    domain = 1 + secrets.randbelow(100)
    arguments = ["--ros-args", "--log-level", "error"]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=domain)
    made: list[Stand] = []
    with Children(child_environment(domain)) as children:

        def make(*words: str, qos: QoSProfile | None = None) -> Stand:
            made.append(Stand(tmp_path, children, domain, qos or chain_qos(), *words))
            return made[-1]

        yield make
        for each in made:
            each.robot.stop()
    for each in made:
        each.robot.node.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize("words", [(), ("depth:=10",)], ids=["deep", "a queue of ten"])
def test_a_recorder_that_stood_still_counts_what_it_missed(stand: Callable[..., Stand], words: tuple[str, ...]) -> None:
    found = stand(*words)
    found.begin()
    found.recorder.send_signal(signal.SIGSTOP)
    time.sleep(STOPPED)
    found.recorder.send_signal(signal.SIGCONT)
    found.run(500)
    found.robot.stop()
    time.sleep(0.2)
    found.robot.publish()
    time.sleep(0.2)
    assert found.end() == 0, found.log.read_text()
    drops = found.balance()
    if words:
        assert all(drops[name]["transport"] > 0 for name in NEEDED)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_signal_under_traffic_closes_the_bag(stand: Callable[..., Stand], number: int) -> None:
    """What arrived until then is in it; nobody waits until the traffic ends."""
    found = stand()
    found.begin()
    before = found.robot.published
    assert found.end(number) == 0, found.log.read_text()
    reader = BagReader(found.bag)
    assert reader.complete
    for name in NEEDED:
        account = reader.accounting[f"{found.space}/{name}"]
        assert before <= account["written"] + sum(account["drops"].values()) <= found.robot.published


def test_a_killed_recorder_node_loses_less_than_100_ms(stand: Callable[..., Stand]) -> None:
    found = stand()
    found.begin()
    found.run(300)
    arrived = found.robot.published
    found.recorder.kill()
    found.recorder.wait(LIMIT)
    reader = BagReader(found.bag)
    for name in NEEDED:
        last = (int(reader.columns(f"{found.space}/{name}").stamps_ns[-1]) - found.robot.first_ns) // 1_000_000
        assert last > arrived - 100, "ticks of 1 ms"


def test_other_types_and_other_qualities_of_service(stand: Callable[..., Stand]) -> None:
    """A text on a topic of the chain is not taken for a sample; a publisher that does not answer is recorded too."""
    found = stand(qos=QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    context = Context()  # one participant cannot have both types
    rclpy.init(args=["--ros-args", "--log-level", "error"], context=context, domain_id=found.domain)
    stranger = Node("stranger", namespace=found.space, context=context)
    other = stranger.create_publisher(String, NEEDED[0], 10)
    found.begin()
    for _ in range(20):
        other.publish(String(data="x" * 100))
        found.run(5)
    stranger.destroy_node()
    context.shutdown()
    found.robot.stop()
    time.sleep(0.2)
    found.robot.publish()
    time.sleep(0.2)
    assert found.end() == 0, found.log.read_text()
    found.balance()


def test_topics_without_publisher_do_not_hold_the_others_up(stand: Callable[..., Stand]) -> None:
    """Only one sensor is there: it is recorded, and no progress is reported."""
    found = stand()
    for name in NEEDED[1:]:
        found.robot.node.destroy_publisher(found.robot.ends[name])
    end, codec = found.robot.ends[NEEDED[0]], found.robot.codecs[NEEDED[0]]
    assert until(end.get_subscription_count), found.log.read_text()
    assert until(lambda: "recording into" in found.log.read_text())
    time.sleep(0.5)
    for tick in range(300):
        values = dict.fromkeys(codec.fields, np.full(2, float(tick)))
        end.handle.publish_raw(codec.encode(tick * 1_000_000, "0123456789abcdef", **values))
        time.sleep(0.001)
    time.sleep(0.2)
    assert not found.robot.ready()
    assert found.end() == 0, found.log.read_text()
    account = BagReader(found.bag).accounting[f"{found.space}/{NEEDED[0]}"]
    assert account["written"] + sum(account["drops"].values()) == 300


def test_a_bag_that_is_there_is_not_touched(stand: Callable[..., Stand]) -> None:
    """A second recorder into the same place does not begin, says why, and the first goes on."""
    found = stand()
    found.begin()
    words = ["--ros-args", "-p", "autostart:=true", "-p", f"bag:={found.bag}", "-r", "__node:=second"]
    command = [sys.executable, "-m", "hd_control.nodes.recorder_node", *words]
    second = found.children.start("second", command, stderr=subprocess.PIPE, text=True)
    assert second.stderr is not None
    said = ""
    while "not activated" not in said:
        line = second.stderr.readline()
        assert line, said
        said += line
    second.send_signal(signal.SIGINT)
    assert second.wait(LIMIT) == 0 and str(found.bag) in said
    found.robot.stop()
    time.sleep(0.2)
    assert found.end() == 0
    assert BagReader(found.bag).complete
