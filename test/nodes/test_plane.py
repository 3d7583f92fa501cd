"""The compiled loop on real topics: joins, acts, publishes, counts, and lets itself be switched and taken down."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import secrets
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
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, Temperature

from hd_control import _plane
from hd_control.core import topics
from hd_control.nodes.fast_loop import (
    FastLoop,
    HandsOff,
    JoinedTurn,
    RawInput,
    TemperatureInput,
    chain_qos,
    message_runs,
    wait_matched,
)
from hd_control.nodes.process import prepare_environment
from hd_control.record.cdr import TemperatureCodec
from hd_control.record.schema import joint_state_codec
from hd_control.session.session import child_environment

NAMES = ("a", "b", "c")
PERIOD_NS = 1_000_000
RUN, OTHER = "f" * 16, "e" * 16
SECONDS = 10.0
"""s that a machine with other work may take for what takes milliseconds."""


@pytest.fixture
def node() -> Iterator[Node]:
    prepare_environment()
    rclpy.init(
        args=["--ros-args", "--log-level", "fatal"],
        signal_handler_options=SignalHandlerOptions.NO,
        domain_id=1 + secrets.randbelow(100),
    )
    faulthandler.dump_traceback_later(120.0 + CYCLES, exit=True)
    made = Node("plane_test")
    yield made
    made.destroy_node()
    rclpy.shutdown()
    faulthandler.cancel_dump_traceback_later()


def until(done: Callable[[], bool]) -> bool:
    end = time.monotonic() + SECONDS
    while not done() and time.monotonic() < end:
        time.sleep(0.002)
    return done()


class Ring:
    """encoder and resolver in, joint_states out: a loop in a thread, publishers and a listener beside it."""

    def __init__(self, node: Node, poll: bool = False, optional: tuple[int, ...] = ()) -> None:
        self.node, self.group = node, HandsOff()
        self.numbers = np.zeros((2, len(NAMES)))
        self.raws = [RawInput(node, topic, NAMES, self.group) for topic in (topics.ENCODER, topics.RESOLVER)]
        self.codecs = [raw.codec for raw in self.raws]
        places = [{"position": [(row, range(len(NAMES)))]} for row in self.numbers]
        self.turn = JoinedTurn(self.raws, places, PERIOD_NS, optional, poll=poll)
        self.plane = self.turn.plane
        self.publishers = [node.create_publisher(JointState, raw.topic, chain_qos(10)) for raw in self.raws]
        self.out = node.create_publisher(JointState, topics.JOINT_STATES, chain_qos(100))
        self.out_codec = joint_state_codec(topics.JOINT_STATES, NAMES)
        self.answers = RawInput(node, topics.JOINT_STATES, NAMES, self.group, depth=100)
        self.loop = FastLoop(node)
        self.thread = threading.Thread(target=self.loop.run, daemon=True)
        self.acted: list[tuple[int, list[float]]] = []

    def outbox(self) -> _plane.Outbox:
        runs = message_runs(self.out_codec, dict.fromkeys(("position", "velocity", "effort"), self.numbers[0]))
        codec = self.out_codec
        return self.plane.outbox(self.out.handle, codec.encode(0, RUN), codec.stamp_place, runs)

    def note(self, tick: int) -> None:
        self.acted.append((tick, self.numbers.ravel().tolist()))

    def start(self) -> None:
        self.thread.start()
        self.loop.install(self.turn)
        self.turn.active = True
        ends = [raw.subscription for raw in (*self.raws, self.answers)]
        assert wait_matched(ends, [*self.publishers, self.out], SECONDS)

    def send(self, index: int, tick: int, run_id: str = RUN) -> None:
        position = [tick + 0.1 * index] * len(NAMES)
        data = self.codecs[index].encode(tick * PERIOD_NS, run_id, position=position)
        self.publishers[index].handle.publish_raw(data)

    def send_both(self, tick: int, run_id: str = RUN) -> None:
        self.send(0, tick, run_id), self.send(1, tick, run_id)

    def act_on(self, tick: int, run_id: str = RUN) -> bool:
        """Both inputs of a tick; True once it was acted on."""
        self.send_both(tick, run_id)
        return until(lambda: any(acted == tick for acted, _ in self.acted))

    def answer(self) -> bytes | None:
        taken: list[bytes] = []

        def found() -> bool:
            one = self.answers.subscription.handle.take_message(JointState, True)
            taken.extend([] if one is None else [one[0]])
            return bool(taken)

        return taken[0] if until(found) else None

    def close(self) -> None:
        self.loop.stop()
        self.thread.join(SECONDS)
        assert not self.thread.is_alive()
        self.turn.close()


@pytest.fixture(params=["woken", "polling"])
def ring(node: Node, request: pytest.FixtureRequest) -> Iterator[Ring]:
    made = Ring(node, poll=request.param == "polling")
    made.plane.program.step(made.note)
    yield made
    made.close()


def test_a_tick_acts_once_all_inputs_are_there_and_is_answered(ring: Ring) -> None:
    ring.plane.program.send(ring.outbox())
    ring.start()
    assert ring.act_on(7)
    assert ring.acted == [(7, [7.0] * 3 + [7.1] * 3)]
    row = [7.0] * 3
    assert ring.answer() == ring.out_codec.encode(7 * PERIOD_NS, RUN, position=row, velocity=row, effort=row)
    ring.send(0, 8)  # nobody is woken for it, but a loop looks around ten times a second
    assert until(lambda: ring.turn.tick == 8)
    assert ring.act_on(9)
    found = ring.plane.statistics.summary()
    assert (found["ticks"], found["missed"], found["incomplete"], found["foreign"]) == (2, 1, 1, 0)


def test_while_not_active_messages_are_taken_and_dropped(ring: Ring) -> None:
    ring.start()
    ring.turn.active = False
    ring.send_both(3)
    assert until(lambda: ring.turn.tick == 3)
    ring.turn.active = True
    assert ring.act_on(4)
    assert [tick for tick, _ in ring.acted] == [4]


def test_f19_f24_another_run_id_is_counted_and_bound_again_by_a_new_activation(ring: Ring) -> None:
    ring.start()
    assert ring.act_on(1)
    ring.send_both(2, OTHER)
    assert until(lambda: ring.plane.dropped(0) == (1, 0) and ring.plane.dropped(1) == (1, 0))
    assert [tick for tick, _ in ring.acted] == [1]
    ring.turn.restart()
    assert ring.act_on(3, OTHER)


def test_a_foreign_order_of_joints_is_mapped_by_name_and_other_robots_are_counted(ring: Ring) -> None:
    ring.start()
    message = JointState(name=["c", "x", "a", "b"], position=[3.0, 9.0, 1.0, 2.0])
    message.header.stamp.nanosec, message.header.frame_id = 5 * PERIOD_NS, "robot"
    ring.publishers[0].publish(message)
    ring.send(1, 5)
    assert until(lambda: bool(ring.acted))
    assert ring.acted == [(5, [1.0, 2.0, 3.0] + [5.1] * 3)]
    ring.publishers[0].publish(JointState(name=["a", "b"], position=[1.0, 2.0]))
    assert until(lambda: ring.plane.dropped(0) == (0, 1))
    assert ring.plane.statistics.foreign == 1


def test_f02_f16_a_repeated_tick_gets_the_answer_again_and_never_acts_twice(ring: Ring) -> None:
    repeated: list[int] = []
    ring.plane.again.step(repeated.append)
    ring.start()
    assert ring.act_on(4)
    ring.send(1, 4)
    assert until(lambda: repeated == [4])
    assert len(ring.acted) == 1


def test_f33_a_step_that_raises_ends_the_work_and_the_loop_lives_on(ring: Ring) -> None:
    def broken(tick: int) -> None:
        raise RuntimeError("a bug in a law")

    ring.plane.program.step(broken)
    ring.start()
    ring.send_both(1)
    assert until(lambda: ring.loop.error is not None)
    assert str(ring.loop.error) == "a bug in a law" and ring.thread.is_alive()


def test_a_loop_with_a_step_in_python_says_that_it_is_not_real_time(node: Node) -> None:
    ring = Ring(node)
    ring.plane.program.send(ring.outbox())
    assert ring.plane.real_time and ring.turn.kind == "compiled"
    ring.plane.program.step(ring.note)
    assert not ring.plane.real_time and ring.turn.kind.startswith("not real time")
    ring.turn.close()


class _Step(ctypes.Structure):
    _fields_ = [("context", ctypes.c_void_p), ("run", ctypes.c_void_p)]


def test_a_compiled_step_runs_with_the_tick_and_its_own_memory(node: Node) -> None:
    seen: list[tuple[int, int]] = []
    run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64)(lambda context, tick: seen.append((context, tick)))
    step = _Step(42, ctypes.cast(run, ctypes.c_void_p).value)
    new = ctypes.pythonapi.PyCapsule_New
    new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    ring = Ring(node)
    with pytest.raises(ValueError, match="function or a capsule"):
        ring.plane.program.step(new(ctypes.addressof(step), b"another", None))
    ring.plane.program.step(new(ctypes.addressof(step), b"hd.step", None))
    ring.plane.program.copy(ring.numbers[1], ring.numbers[0])
    ring.plane.program.send(ring.outbox())
    ring.start()
    ring.send_both(11)
    assert ring.answer() is not None
    assert seen == [(42, 11)] and ring.plane.real_time
    np.testing.assert_array_equal(ring.numbers[0], [11.1] * 3)
    ring.close()


def test_until_an_optional_input_is_seen_its_numbers_are_substituted(node: Node) -> None:
    ring = Ring(node, optional=(0,))
    ring.plane.substitute(0, ring.numbers[0], ring.numbers[1])
    ring.plane.program.step(ring.note)
    ring.start()
    ring.send(1, 1)
    assert until(lambda: bool(ring.acted))
    assert ring.acted == [(1, [1.1] * 6)] and not ring.plane.seen(0)
    assert ring.act_on(2) and ring.plane.seen(0)
    assert ring.acted[1] == (2, [2.0] * 3 + [2.1] * 3)
    ring.close()


def test_temperatures_are_there_before_the_tick_they_came_before(node: Node) -> None:
    ring, held = Ring(node), np.full(2, np.nan)
    slow = TemperatureInput(node, NAMES, ring.group)
    ring.turn.add_temperature(slow, {"b": [(held, 1)]})
    ring.plane.program.step(ring.note)
    publisher = node.create_publisher(Temperature, topics.TEMPERATURE, chain_qos(10))
    ring.start()
    assert wait_matched([slow.subscription], [publisher], SECONDS)
    publisher.handle.publish_raw(TemperatureCodec("b").encode(0, "b", temperature=31.5))
    publisher.handle.publish_raw(TemperatureCodec("elsewhere").encode(0, "elsewhere", temperature=99.0))
    tick = 0
    while np.isnan(held[1]) and tick < 1000:
        tick += 1
        assert ring.act_on(tick)
    np.testing.assert_array_equal(slow.values["temperature"], [np.nan, 31.5, np.nan])
    np.testing.assert_array_equal(held, [np.nan, 31.5])
    ring.close()


def test_numbers_that_would_move_are_refused() -> None:
    loop = _plane.JoinedLoop(PERIOD_NS)
    good = np.zeros(3)
    for bad in (np.zeros(6)[::2], np.zeros(3, dtype=np.float32), np.zeros(4)):
        with pytest.raises(ValueError):
            loop.program.copy(good, bad)


# Switching and taking down under traffic. `HD_PLANE_CYCLES=1000` for the whole number.

CYCLES = int(os.environ.get("HD_PLANE_CYCLES", "20"))


FLOOD = f"""
import signal, sys, time
import rclpy, rclpy.signals
from sensor_msgs.msg import JointState
from hd_control.nodes.fast_loop import chain_qos
from hd_control.record.schema import joint_state_codec

rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
node = rclpy.create_node("flood")
topics = ("{topics.ENCODER}", "{topics.RESOLVER}")
codecs = [joint_state_codec(topic, {NAMES}) for topic in topics]
publishers = [node.create_publisher(JointState, topic, chain_qos(10)) for topic in topics]
tick, ends = 0, []
signal.signal(signal.SIGTERM, lambda *_: ends.append(True))
while not ends:
    tick += 1
    for codec, publisher in zip(codecs, publishers):
        publisher.handle.publish_raw(codec.encode(tick * {PERIOD_NS}, "{RUN}", position=[float(tick)] * {len(NAMES)}))
    time.sleep(0.0002)
node.destroy_node()
rclpy.shutdown()
"""


class Flood:
    """Both inputs as fast as it goes, by one who knows nothing of who takes them.

    From this process they reach a loop in the sender's thread, from another one in a thread of the middleware. The
    other one ends in order: a writer that is killed takes a port of the shared memory with it, and Fast DDS 2.14 then
    reads unmapped memory when this node closes its end (`SharedMemChannelResource::release`).
    """

    def __init__(self, ring: Ring, kind: str) -> None:
        self._ring, self._ending = ring, threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        if kind == "process":
            environment = child_environment(ring.node.context.get_domain_id(), False)
            self._process = subprocess.Popen([sys.executable, "-c", FLOOD], env=environment)
        else:
            self._thread.start()

    def _run(self) -> None:
        tick = 0
        while not self._ending.is_set():
            tick += 1
            self._ring.send_both(tick)
            time.sleep(0.0002)

    def stop(self) -> None:
        self._ending.set()
        if self._process is not None:
            self._process.terminate()
            self._process.wait(SECONDS)
        else:
            self._thread.join(SECONDS)


@pytest.fixture(params=["thread", "process"])
def flood(node: Node, request: pytest.FixtureRequest) -> Iterator[Flood]:
    sender = Ring(node)
    made = Flood(sender, request.param)
    yield made
    made.stop()
    sender.turn.close()


def test_activations_under_traffic_leave_no_step_running(node: Node, flood: Flood) -> None:
    ring = Ring(node)
    inside = np.zeros(1)

    def step(tick: int) -> None:
        inside[0] = 1.0
        ring.note(tick)
        inside[0] = 0.0

    ring.plane.program.step(step)
    ring.plane.program.send(ring.outbox())
    ring.start()
    for _ in range(5 * CYCLES):
        ring.turn.restart()
        ring.turn.active = True
        count = len(ring.acted)
        assert until(lambda before=count: len(ring.acted) > before)
        ring.turn.active = False
        count = len(ring.acted)
        assert inside[0] == 0.0, "a step runs after the end of the activation"
        time.sleep(0.001)
        assert len(ring.acted) == count
    ring.close()


def test_topics_can_be_made_and_destroyed_under_traffic(node: Node, flood: Flood) -> None:
    """Configure, activate, deactivate, clean up: with messages arriving in every moment of it."""
    for cycle in range(CYCLES):
        ring = Ring(node, poll=cycle % 4 == 3)
        ring.plane.program.step(ring.note)
        ring.plane.program.send(ring.outbox())
        ring.thread.start()
        ring.loop.install(ring.turn)
        ring.turn.active = True
        assert until(lambda: bool(ring.acted)), cycle  # noqa: B023
        if cycle % 2:
            ring.loop.remove()
            assert ring.loop._outside.is_set()
        else:
            ring.loop.stop()
        ring.turn.close()
        ring.turn.close()
        for raw in (*ring.raws, ring.answers):
            node.destroy_subscription(raw.subscription)
        for publisher in (*ring.publishers, ring.out):
            node.destroy_publisher(publisher)
        ring.loop.stop()
        ring.thread.join(SECONDS)
        assert not ring.thread.is_alive(), cycle


def test_topics_destroyed_too_early_stay_usable_until_the_loop_is_closed(node: Node, flood: Flood) -> None:
    """rclpy destroys the rcl entity only when the loop has let go of it."""
    ring = Ring(node)
    ring.plane.program.step(ring.note)
    ring.plane.program.send(ring.outbox())
    ring.start()
    assert until(lambda: bool(ring.acted))
    for raw in ring.raws:
        node.destroy_subscription(raw.subscription)
    node.destroy_publisher(ring.out)
    count = len(ring.acted)
    assert until(lambda: len(ring.acted) > count + 5)
    ring.close()


def test_a_context_shut_down_under_traffic_ends_nothing_but_the_traffic() -> None:
    for _ in range(max(1, CYCLES // 10)):
        context: Any = rclpy.Context()
        rclpy.init(
            context=context, signal_handler_options=SignalHandlerOptions.NO, domain_id=1 + secrets.randbelow(100)
        )
        node = Node("plane_end", context=context)
        ring = Ring(node)
        ring.plane.program.step(ring.note)
        ring.plane.program.send(ring.outbox())
        ring.start()
        assert ring.act_on(1)
        stop = threading.Event()

        def send(ring: Ring = ring, stop: threading.Event = stop) -> None:
            tick = 1
            while not stop.is_set():
                tick += 1
                try:
                    ring.send_both(tick)
                except Exception:
                    return  # the context has ended

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        time.sleep(0.01)
        rclpy.shutdown(context=context)
        ring.plane.interrupt()
        stop.set()
        thread.join(SECONDS)
        ring.loop.stop()
        ring.turn.close()
        node.destroy_node()


def test_ticks_go_on_while_another_thread_holds_the_interpreter(node: Node, tmp_path: Path) -> None:
    """A loop whose steps are compiled needs no interpreter: a call that keeps it for half a second holds nothing up."""
    ring = Ring(node)
    ring.plane.program.copy(ring.numbers[1], ring.numbers[0])
    ring.plane.program.send(ring.outbox())
    ring.start()
    sender = tmp_path / "sender.py"
    sender.write_text(FLOOD)
    flood = subprocess.Popen([sys.executable, str(sender)], env=child_environment(node.context.get_domain_id(), False))
    try:
        assert until(lambda: ring.turn.tick > 0)
        hold = ctypes.PyDLL(None).usleep  # PyDLL keeps the interpreter lock during the call

        def went_on() -> bool:
            before = ring.turn.tick
            hold(200_000)
            return ring.turn.tick > before + 1

        assert until(went_on)
    finally:
        flood.terminate()
        flood.wait(SECONDS)
    ring.close()
