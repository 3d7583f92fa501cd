"""The pump outlives nothing that it uses: nodes, subscriptions and contexts end in every order while messages arrive.

Traffic comes from another process, so messages are received by the middleware's own threads. Each order runs some
times here and 1000 times in the campaign ENDS.
"""

from __future__ import annotations

import faulthandler
import gc
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import UInt64

from hd_control._pump import Pump
from hd_control.nodes import recorder_node
from hd_control.nodes.fast_loop import HandsOff, latched_qos
from hd_control.nodes.process import prepare_environment
from hd_control.nodes.recorder_node import NEEDED, PumpTaking, RecordedTopic, RecorderNode
from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.writer import BagWriter
from hd_control.session.session import Children, child_environment

HERE = Path(__file__).parent
TIMES = 5
TICK, DEPTH, LIMIT = 1_000_000, 200, 20.0

TRAFFIC = """
import time, rclpy, numpy as np
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from hd_control.nodes.fast_loop import chain_qos
from hd_control.nodes.recorder_node import NEEDED
from hd_control.record.schema import joint_state_codec
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node("traffic")
codecs = [joint_state_codec(name, ("a", "b")) for name in NEEDED]
ends = [node.create_publisher(JointState, name, chain_qos(5)) for name in NEEDED]
tick = 0
while True:
    for codec, end in zip(codecs, ends):
        end.handle.publish_raw(codec.encode(tick * 1_000_000, "0123456789abcdef", **{
            name: np.full(2, float(tick)) for name in codec.fields}))
    tick += 1
    time.sleep(0.0005)
"""


@contextmanager
def traffic() -> Iterator[int]:
    """A domain in which another process publishes all that a recorder needs, about 2000 times a second."""
    prepare_environment()
    number = 1 + secrets.randbelow(100)
    faulthandler.enable()
    with Children(child_environment(number)) as children:
        children.start("traffic", [sys.executable, "-c", TRAFFIC])
        yield number
        assert not children.dead(), "the traffic ended by itself"


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    with traffic() as number:
        yield number


@contextmanager
def context_in(domain: int) -> Iterator[Context]:
    context = Context()
    rclpy.init(args=["--ros-args", "--log-level", "error"], context=context, domain_id=domain)
    yield context
    context.try_shutdown()


def until(true: Callable[[], Any]) -> bool:
    end = time.monotonic() + LIMIT
    while not (found := true()) and time.monotonic() < end:
        time.sleep(0.001)
    return bool(found)


class Recording:
    """A pump that records in a node of its own."""

    def __init__(self, context: Context, folder: Path, rest: bool = True) -> None:
        self.node = Node("recording", context=context)
        self.topics = [RecordedTopic(self.node, name, DEPTH, HandsOff(), False) for name in NEEDED]
        self.progress = self.node.create_publisher(UInt64, "recorder/progress", latched_qos())
        self.taking = PumpTaking(self.topics, TICK, self.progress, rest)
        context.on_shutdown(self.taking.end)
        self.recorder = Recorder(BagWriter(folder, compact=False))
        for topic in self.topics:
            self.recorder.add_topic(topic.path)
        self.recorder.write_beside()
        self.taking.record(self.recorder)
        self.taking.report(self.recorder)

    def run(self) -> None:
        """Until every topic has come."""
        assert until(lambda: self.recorder.newest_ns >= 0), "no traffic arrives"


def subscriptions_first(recording: Recording, context: Context) -> None:
    for topic in recording.topics:
        recording.node.destroy_subscription(topic.subscription)
    recording.taking.end()


def pump_first(recording: Recording, context: Context) -> None:
    recording.taking.end()
    recording.taking.end()
    recording.node.destroy_node()


def node_first(recording: Recording, context: Context) -> None:
    recording.node.destroy_node()
    recording.taking.end()


def context_first(recording: Recording, context: Context) -> None:
    context.shutdown()
    recording.node.destroy_node()


def node_then_context(recording: Recording, context: Context) -> None:
    recording.node.destroy_node()
    context.shutdown()


def let_go(recording: Recording, context: Context) -> None:
    """Nobody ends anything: the garbage collector finds node, topics and pump in a circle."""
    recording.node.circle = recording


ORDERS = (subscriptions_first, pump_first, node_first, context_first, node_then_context, let_go)


def end_once(domain: int, folder: Path, order: Callable[[Recording, Context], None], number: int) -> None:
    """One recording that ends so; in odd rounds at once, in each third without rests. The counts must balance."""
    with context_in(domain) as context:
        recording = Recording(context, folder, rest=number % 3 > 0)
        if number % 2 == 0:
            recording.run()
        recorder = recording.recorder
        order(recording, context)
        del recording
        gc.collect()
    gc.collect()
    assert recorder.close() == ""
    table = recorder.statistics().values()
    assert all(row["received"] == row["written"] + row["drops"]["queue"] for row in table)
    bag = BagReader(folder)
    assert bag.complete and (number % 2 or bag.counts[f"/{NEEDED[0]}"] > 0)


@pytest.mark.parametrize("order", ORDERS, ids=lambda order: order.__name__)
def test_every_order_of_ends_under_traffic(
    domain: int, tmp_path: Path, order: Callable[[Recording, Context], None]
) -> None:
    for number in range(TIMES):
        end_once(domain, tmp_path / str(number), order, number)


def test_nothing_is_taken_after_the_end(domain: int, tmp_path: Path) -> None:
    """Also not by a pump that is started again: what it used is gone."""
    with context_in(domain) as context:
        recording = Recording(context, tmp_path / "bag")
        recording.run()
        pump = recording.taking._pump
        pump.end()
        taken = pump.taken
        pump.start(True, 0)
        time.sleep(0.05)
        assert pump.taken == taken
        recording.node.destroy_node()
        recording.recorder.close()


def test_what_is_destroyed_is_refused(domain: int) -> None:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    with context_in(domain) as context:
        node = Node("refused", context=context)
        subscription = RecordedTopic(node, NEEDED[0], DEPTH, HandsOff(), False).subscription
        node.destroy_subscription(subscription)
        with pytest.raises(rclpy_implementation.InvalidHandle):
            Pump(TICK).add(subscription.handle, True)
        node.destroy_node()


# ---- The node itself -------------------------------------------------------------------------------


def activated(node: RecorderNode, bag: Path) -> Path:
    """Begins a new bag and waits until it grows."""
    assert node.set_parameters([Parameter("bag", value=str(bag))])[0].successful
    node.trigger_activate()
    assert node.active and until(lambda: node.recorder.newest_ns >= 0)
    return bag


def test_lifecycle_under_traffic(domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Configured twice, active three times, then destroyed in the middle or in order; each bag is whole."""
    monkeypatch.setattr(recorder_node, "FINISH_NS", 20_000_000)
    for number in range(TIMES):
        arguments = ["--ros-args", "--log-level", "error"]
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO, domain_id=domain)
        node = RecorderNode()
        loop = threading.Thread(target=node.loop.run)
        loop.start()
        node.trigger_configure()
        bags = []
        for activation in range(2):
            bags.append(activated(node, tmp_path / f"{number}_{activation}"))
            node.trigger_deactivate()
        node.trigger_cleanup()
        node.trigger_configure()
        if number % 2:
            bags.append(activated(node, tmp_path / f"{number}_last"))
        node.loop.stop()
        loop.join()
        if number % 4 < 2:
            node.destroy_node()
            rclpy.shutdown()
        else:
            rclpy.shutdown()
            node.destroy_node()
        assert node.fault == ""
        for bag in bags:
            assert BagReader(bag).complete


AT_EXIT = """
import sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
from test_recorder_lifetime import *
import rclpy
rclpy.init()
recording = Recording(rclpy.get_default_context(), Path({bag!r}))
recording.run()
if {how!r} == "circle":
    recording.node.circle = recording
elif {how!r} == "error":
    raise SystemExit(7)
"""


@pytest.mark.parametrize("how", ["plain", "circle", "error"])
def test_an_interpreter_that_ends_while_the_pump_runs(domain: int, tmp_path: Path, how: str) -> None:
    """No shutdown, no destruction: neither a crash nor a hang."""
    for number in range(max(1, TIMES // 5)):
        bag = tmp_path / str(number)
        code = AT_EXIT.format(here=str(HERE), bag=str(bag), how=how)
        done = subprocess.run(
            [sys.executable, "-X", "faulthandler", "-c", code],
            env=child_environment(domain),
            timeout=60,
            capture_output=True,
            text=True,
        )
        assert done.returncode == (7 if how == "error" else 0), done.stderr
        assert BagReader(bag).counts[f"/{NEEDED[0]}"] > 0
