"""The fast loop: messages in, one tick, messages out, in a thread that does not need the interpreter.

A stock executor needs about half a millisecond per callback, so at 1 kHz over four processes it misses nearly every
tick; a loop in Python waits for the interpreter lock whenever another thread of its process has it. So the loop is
compiled (`hd_control/cpp/plane.hpp`): it takes the bytes of subscriptions by address, joins them by tick, runs the
step, publishes and counts. Python makes a loop, switches it and reads its counters. The subscriptions belong to a
callback group that the executor may never run; an executor in a second thread serves parameters, lifecycle, goals and
diagnostics.

A step in Python is possible too, for experiments and for laws that are not compiled: the loop then asks for the
interpreter lock in each tick, and `real_time` of the loop is false.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, Temperature

from hd_control import _plane
from hd_control.chain.stage import TICK
from hd_control.core.arrays import FloatArray
from hd_control.core.topics import TEMPERATURE
from hd_control.record.cdr import FixedCodec, JointStateCodec, TemperatureCodec
from hd_control.record.schema import joint_state_codec

# ---- Messages: bytes into blocks, blocks into bytes ------------------------------------------------


Destinations = Mapping[str, Sequence[tuple[FloatArray, Sequence[int]]]]
"""By array of the message: views to write to, each with the joints (by index in the message) that it takes.

Under `TICK`: where the tick of the message goes."""
JOINT_FIELDS = ("position", "velocity", "effort")


def make_input(codec: FixedCodec, destinations: Destinations, optional: bool = False) -> _plane.Input:
    """An input whose arrays are written straight to their destinations when a message is taken."""
    offsets, targets, places = [], [], []
    ((ticks, (tick_place,)),) = destinations.get(TICK, [(None, [0])])
    for name, wanted in destinations.items():
        if name == TICK:
            continue
        start, _ = codec.places[name]
        for view, joints in wanted:
            for place, joint in enumerate(joints):
                offsets.append(start + 8 * joint)
                targets.append(view)
                places.append(place)
    fixed, mask, numbers = codec.fixed_bytes, codec.mask_bytes, (offsets, targets, places)
    return _plane.Input(fixed, mask, codec.stamp_place, *codec.frame_place, *numbers, optional, ticks, tick_place)


def make_translator(codec: JointStateCodec, run_id_length: int = 16) -> _plane.Translator:
    """Messages of other programs, in the layout of this package: mapped by joint name, arrays that are not there "not
    a number"; empty bytes if joints are missing. It costs ten times as much as reading the layout that is expected.
    """
    fields = [(JOINT_FIELDS.index(name), start) for name, (start, _) in codec.places.items()]
    expected = codec.encode(0, " " * run_id_length)
    return _plane.Translator(make_input(codec, {}), list(codec.joint_names), expected, fields)


def message_runs(codec: FixedCodec, arrays: Mapping[str, FloatArray]) -> list[tuple[int, FloatArray]]:
    """Where the arrays of a message are taken from: byte offsets with views of the numbers, each in a row."""
    return [(codec.places[name][0], numbers) for name, numbers in arrays.items()]


# ---- What a loop did -------------------------------------------------------------------------------


LoopStatistics = _plane.Statistics
"""Counters and a ring of tick times of one loop, percentiles over the newest 1024 ticks."""


def missed_percent(plant: Mapping[str, str]) -> float:
    """Ticks at which the plant had to hold an old command, or that it overslept, per hundred; from its diagnostics."""
    skipped, late = float(plant.get("skipped", 0)), float(plant.get("late", 0))
    ticks = float(plant.get("ticks", 0)) + skipped
    return 100.0 * (late + skipped) / ticks if ticks else 0.0


# ---- The loop --------------------------------------------------------------------------------------


WAIT_NS = 100_000_000


class HandsOff(CallbackGroup):
    """A callback group whose entities the executor never waits for and never runs."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


def chain_qos(depth: int = 1) -> QoSProfile:
    """Reliable, volatile, keep last `depth` (1 on the chain: only the newest sample counts)."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def latched_qos() -> QoSProfile:
    """Reliable, keep last 1, given to late joiners as well."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class RawInput:
    """A JointState topic taken as bytes. `joint_names` are all joints of the robot, in order."""

    def __init__(self, node: Node, topic: str, joint_names: Sequence[str], group: HandsOff, depth: int = 1) -> None:
        self.topic, self.joint_names = topic, tuple(joint_names)
        self.codec = joint_state_codec(topic, self.joint_names)
        self.subscription = node.create_subscription(
            JointState, topic, lambda _: None, chain_qos(depth), callback_group=group, raw=True
        )


class TemperatureInput:
    """`motor_temperature`: one message per joint now and then. The newest value of every joint is held, in °C."""

    def __init__(self, node: Node, joint_names: Sequence[str], group: HandsOff) -> None:
        self.joint_names = tuple(joint_names)
        self.subscription = node.create_subscription(
            Temperature, TEMPERATURE, lambda _: None, chain_qos(2 * len(joint_names)), callback_group=group, raw=True
        )
        self.values = {"temperature": np.full(len(joint_names), np.nan)}


def wait_matched(subscriptions: Sequence[Any], publishers: Sequence[Any], timeout: float = 1.0) -> bool:
    """Waits until every topic has another end: a first message is not lost to discovery then. False at the timeout."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        heard = all(subscription.handle.get_publisher_count() for subscription in subscriptions)
        if heard and all(publisher.get_subscription_count() for publisher in publishers):
            return True
        time.sleep(0.01)
    return False


class Waiter:
    """Waits on chosen subscriptions and on a guard condition that ends every wait."""

    def __init__(self, node: Node, subscriptions: int) -> None:
        self._guard = _rclpy.GuardCondition(node.context.handle)
        self._set = _rclpy.WaitSet(subscriptions, 1, 0, 0, 0, 0, node.context.handle)

    def wait(self, handles: Sequence[Any], timeout_ns: int = WAIT_NS) -> None:
        """Returns when one of the subscriptions has a message, after `wake`, or after the timeout."""
        wait_set = self._set
        wait_set.clear_entities()
        for handle in handles:
            wait_set.add_subscription(handle)
        wait_set.add_guard_condition(self._guard)
        wait_set.wait(timeout_ns)

    def wake(self) -> None:
        """Ends the present or the next wait; may be called from any thread."""
        self._guard.trigger_guard_condition()


class NativeTurn:
    """Work of the fast loop that runs compiled from `install` to `remove`. `close` before its topics are destroyed."""

    def __init__(self, plane: _plane.Loop) -> None:
        self.plane = plane
        self.statistics = plane.statistics

    def __call__(self) -> None:
        """Runs until the loop wants the thread back. Raises what a step in Python raised."""
        self.plane.run()

    @property
    def kind(self) -> str:
        """For diagnostics."""
        how = "compiled" if self.plane.real_time else "not real time: a step in Python"
        return f"{how}; looks for messages every 0.1 ms" if self.plane.polled else how

    def close(self) -> None:
        """The end; the loop is outside. No message is taken and none is published after it."""
        self.plane.close()


class FastLoop:
    """Runs the installed turn again and again in the calling thread until `stop`."""

    def __init__(self, node: Node, subscriptions: int = 8) -> None:
        self.waiter = Waiter(node, subscriptions)
        self.error: BaseException | None = None
        self._turn: Callable[[], None] | None = None
        self._stopping = False
        self._outside = threading.Event()

    def run(self) -> None:
        """Blocks until `stop`. An exception of a turn is kept in `error`, the turn is removed, the loop goes on."""
        while not self._stopping:
            turn = self._turn
            if turn is None:
                self._outside.set()
                self.waiter.wait(())
                continue
            try:
                turn()
            except Exception as error:  # F33: the node lives on; the shell reports it
                self.error, self._turn = error, None
        self._outside.set()

    @property
    def stopping(self) -> bool:
        """True once `stop` was called."""
        return self._stopping

    def install(self, turn: Callable[[], None]) -> None:
        """Makes `turn` the work of the loop."""
        self.error = None
        self._outside.clear()
        if isinstance(turn, NativeTurn):
            turn.plane.rearm()
        self._turn = turn
        self.waiter.wake()

    def remove(self, timeout: float = 2.0) -> None:
        """Takes the work away and waits until the loop is outside it, so that its subscriptions may be destroyed."""
        turn, self._turn = self._turn, None
        self._wake(turn)
        if not self._stopping:
            self._outside.wait(timeout)

    def stop(self) -> None:
        """Ends `run`; safe from any thread and from a signal handler's thread."""
        self._stopping = True
        self._wake(self._turn)

    def _wake(self, turn: Callable[[], None] | None) -> None:
        self.waiter.wake()
        if isinstance(turn, NativeTurn):
            turn.plane.interrupt()


class JoinedTurn(NativeTurn):
    """Work of an event-driven node: take, join by stamp, act.

    `destinations[i]` says where the arrays of input i go; they are written before the program of the plane runs, which
    it does only while `active`; otherwise messages are taken and dropped. The loop waits for the last missing input
    only: one wake-up per tick. Inputs in `optional` count once they have been seen. `poll`: messages are looked for, as
    where the middleware cannot wake the loop.
    """

    plane: _plane.JoinedLoop

    def __init__(
        self,
        inputs: Sequence[RawInput],
        destinations: Sequence[Destinations],
        dt_ns: int,
        optional: Collection[int] = (),
        poll: bool = False,
    ) -> None:
        super().__init__(_plane.JoinedLoop(dt_ns, poll))
        for index, (raw, places) in enumerate(zip(inputs, destinations, strict=True)):
            made = make_input(raw.codec, places, index in optional)
            self.plane.add_input(raw.subscription.handle, made, make_translator(raw.codec))

    def add_temperature(self, raw: TemperatureInput, targets: Mapping[str, Sequence[tuple[FloatArray, int]]]) -> None:
        """Temperatures taken before each tick into the held values and, by joint name, to further places."""
        rows = []
        for index, name in enumerate(raw.joint_names):
            made = make_input(TemperatureCodec(name), {"temperature": [(np.zeros(1), [0])]})
            rows.append((made, [(raw.values["temperature"], index), *targets.get(name, ())]))
        self.plane.add_slow(raw.subscription.handle, rows)

    def restart(self) -> None:
        """Forgets ticks and bound run ids, between two ticks."""
        self.plane.restart()

    @property
    def active(self) -> bool:
        """Does a complete tick run the program?"""
        return self.plane.active

    @active.setter
    def active(self, active: bool) -> None:
        self.plane.set_active(active)

    @property
    def tick(self) -> int:
        """The newest tick seen; -1 before the first."""
        return self.plane.tick
