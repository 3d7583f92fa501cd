"""The fast loop: raw messages in, one step, raw messages out, in the main thread and without the executor.

A stock executor needs about half a millisecond per callback, so at 1 kHz over four processes it misses nearly every
tick. Here the subscriptions belong to a callback group that the executor may never run; the loop waits on them itself,
as `rclpy/wait_for_message.py` does, and takes the serialised bytes. Messages are made once; compiled code moves their
bytes into the blocks of a law and back. An executor in a second thread serves parameters, lifecycle, goals and
diagnostics; nothing in the loop logs. What the loop did is counted with a few stores per tick and summed up outside it.
"""

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, Temperature

from hd_control import _messages
from hd_control._messages import COMPLETE, FOREIGN, OTHER_LAYOUT, REPEATED, STORED
from hd_control.chain.stage import TICK
from hd_control.core.arrays import FloatArray
from hd_control.core.topics import TEMPERATURE
from hd_control.record.cdr import JointStateCodec, TemperatureCodec
from hd_control.record.schema import joint_state_codec

# ---- Messages: bytes into blocks, blocks into bytes ------------------------------------------------


Destinations = Mapping[str, Sequence[tuple[FloatArray, Sequence[int]]]]
"""By array of the message: views to write to, each with the joints (by index in the message) that it takes.

Under `TICK`: where the tick of the message goes."""


def add_input(join: _messages.Join, codec: JointStateCodec, destinations: Destinations, optional: bool = False) -> None:
    """Adds an input whose arrays are written straight to their destinations when a message is taken."""
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
    fixed, mask = codec.fixed_bytes, codec.mask_bytes
    join.add(fixed, mask, codec.stamp_place, *codec.frame_place, offsets, targets, places, optional,
             ticks, tick_place)  # fmt: skip


def make_message(codec: JointStateCodec, run_id: str, places: Mapping[str, Sequence[int]]) -> _messages.Message:
    """A message whose arrays are taken from the named places of one array of numbers."""
    template = codec.encode(0, run_id, **{name: np.zeros(len(part)) for name, part in places.items()})
    copies = []
    for name, part in places.items():
        start, _ = codec.places[name]
        copies += [(start + 8 * row, number) for row, number in enumerate(part)]
    return _messages.Message(template, codec.stamp_place, copies)


# ---- What a loop did -------------------------------------------------------------------------------


RING = 1024
"""Ticks that percentiles are taken over: the last second at 1 kHz, and cheap enough to sort beside the loop."""
PLAUSIBLE_AGE_NS = 10_000_000_000


def missed_percent(plant: Mapping[str, str]) -> float:
    """Ticks at which the plant had to hold an old command, or that it overslept, per hundred; from its diagnostics."""
    skipped, late = float(plant.get("skipped", 0)), float(plant.get("late", 0))
    ticks = float(plant.get("ticks", 0)) + skipped
    return 100.0 * (late + skipped) / ticks if ticks else 0.0


class LoopStatistics:
    """Counters and a ring of tick times of one loop.

    The loop calls `tick`; any other thread may call `summary`. A torn reading of the ring costs one sample of a
    percentile, never a wrong counter.
    """

    def __init__(self, dt_ns: int) -> None:
        self.dt_ns = dt_ns
        self.ticks = self.missed = self.incomplete = self.late = self.foreign = 0
        self.last_tick: int | None = None
        self.max_age_ns = 0
        self._times = array("q", bytes(8 * RING))
        self._busy = array("q", bytes(8 * RING))
        self._answers = array("q", bytes(8 * RING))
        self._answer_count = 0

    def answer(self, waited_ns: int) -> None:
        """Notes how long after its sample the complete command of a tick was there (plant only)."""
        self._answers[self._answer_count % RING] = waited_ns
        self._answer_count += 1

    def tick(self, tick: int, started_ns: int, finished_ns: int) -> None:
        """Counts one tick; a step of more than one in the tick number is a gap and counts as missed ticks."""
        if self.last_tick is not None and tick > self.last_tick + 1:
            self.missed += tick - self.last_tick - 1
        self.last_tick = tick
        slot = self.ticks % RING
        self._times[slot] = started_ns
        self._busy[slot] = finished_ns - started_ns
        self.ticks += 1

    def age(self, stamp_ns: int) -> None:
        """Notes how long after its scheduled time a sample was used; lock-step stamps are no wall time and left out."""
        age = time.time_ns() - stamp_ns
        if self.max_age_ns < age < PLAUSIBLE_AGE_NS:
            self.max_age_ns = age

    def summary(self) -> dict[str, float]:
        """Counters, and period and busy time of the last ticks as p50, p99 and maximum, in µs."""
        counters = ("ticks", "missed", "incomplete", "late", "foreign")
        found: dict[str, float] = {name: getattr(self, name) for name in counters}
        found["max_age_us"] = self.max_age_ns / 1000.0
        count = min(self.ticks, RING)
        if count > 2:
            start = self.ticks % RING if self.ticks > RING else 0
            times = np.roll(np.array(self._times, dtype=np.int64), -start)[:count]
            _spread(found, "period", np.diff(times))
            _spread(found, "busy", np.array(self._busy, dtype=np.int64)[:count])
        if self._answer_count:
            _spread(found, "answer", np.array(self._answers, dtype=np.int64)[: min(self._answer_count, RING)])
        self.max_age_ns = 0
        return found


def _spread(found: dict[str, float], name: str, values: NDArray[np.int64]) -> None:
    """Adds p50, p99 and maximum in µs; by one sort, because this runs beside the loop."""
    ordered = np.sort(values)
    last = len(ordered) - 1
    for label, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        found[f"{name}_{label}_us"] = float(ordered[round(share * last)]) / 1000.0


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
        self._take = self.subscription.handle.take_message
        self.foreign = self.unreadable = 0

    def take(self) -> bytes | None:
        """The oldest message waiting, or None."""
        taken = self._take(JointState, True)
        return None if taken is None else taken[0]

    def translated(self, data: bytes) -> bytes | None:
        """A message of another layout in the layout of this package, mapped by joint name; None if joints are missing.

        This is for other programs' nodes; it costs ten times as much as reading the layout that is expected.
        """
        message = deserialize_message(data, JointState)
        names = list(message.name)
        if not set(self.joint_names) <= set(names):
            return None
        order = [names.index(name) for name in self.joint_names]
        arrays = {}
        for name in self.codec.fields:
            numbers = np.array(getattr(message, name))
            arrays[name] = numbers[order] if len(numbers) == len(names) else np.full(len(order), np.nan)
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        run_id = message.header.frame_id.encode("ascii", "replace").decode()
        return self.codec.encode(stamp_ns, f"{run_id:.16}".ljust(16), **arrays)


class TemperatureInput:
    """`motor_temperature`: one message per joint now and then. The newest value of every joint is held, in °C."""

    def __init__(self, node: Node, joint_names: Sequence[str], group: HandsOff) -> None:
        self._codecs = [TemperatureCodec(name) for name in joint_names]
        self.subscription = node.create_subscription(
            Temperature, TEMPERATURE, lambda _: None, chain_qos(2 * len(joint_names)), callback_group=group, raw=True
        )
        self._take = self.subscription.handle.take_message
        self.values = {"temperature": np.full(len(joint_names), np.nan)}

    def drain(self) -> bool:
        """Takes what is waiting into `values`; True if there was anything."""
        found = False
        while (taken := self._take(Temperature, True)) is not None:
            for index, codec in enumerate(self._codecs):
                if codec.matches(taken[0]):
                    self.values["temperature"][index] = codec.decode(taken[0])[1]["temperature"][0]
                    found = True
        return found


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
        self._turn = turn
        self.waiter.wake()

    def remove(self, timeout: float = 2.0) -> None:
        """Takes the work away and waits until the loop is outside it, so that its subscriptions may be destroyed."""
        self._turn = None
        self.waiter.wake()
        if not self._stopping:
            self._outside.wait(timeout)

    def stop(self) -> None:
        """Ends `run`; safe from any thread and from a signal handler's thread."""
        self._stopping = True
        self.waiter.wake()


class JoinedTurn:
    """One turn of an event-driven node: wait, take, join by stamp, act.

    `destinations[i]` says where the arrays of input i go; they are written before `act(tick, stamp_ns)` is called; it
    is called only while `active`; otherwise messages are taken and dropped. The loop waits for the last missing input
    only: one wake-up per tick.
    """

    def __init__(
        self,
        loop: FastLoop,
        inputs: Sequence[RawInput],
        destinations: Sequence[Destinations],
        act: Callable[[int, int], None],
        dt_ns: int,
        optional: Collection[int] = (),
    ) -> None:
        self._loop, self._inputs, self._step, self._dt_ns = loop, tuple(inputs), act, dt_ns
        self._destinations, self._optional = tuple(destinations), tuple(optional)
        self._handles = [(raw.subscription.handle,) for raw in self._inputs]
        self.active = False
        self.on_repeat: Callable[[], None] | None = None
        self.restart()

    def restart(self) -> None:
        """Forgets ticks and bound run ids; called while not active."""
        self.join = _messages.Join(self._dt_ns)
        for index, (raw, places) in enumerate(zip(self._inputs, self._destinations, strict=True)):
            add_input(self.join, raw.codec, places, index in self._optional)
        self.statistics = LoopStatistics(self._dt_ns)

    def __call__(self) -> None:
        self._loop.waiter.wait(self._handles[self.join.last_missing()])
        join = self.join  # after the wait: an activation may have begun a new one meanwhile
        for index, raw in enumerate(self._inputs):
            data = raw.take()
            if data is not None:
                outcome = join.offer(index, data)
                if outcome == COMPLETE:
                    self._act(join)
                elif outcome != STORED:
                    self._unusual(join, index, raw, data, outcome)

    def _unusual(self, join: _messages.Join, index: int, raw: RawInput, data: bytes, outcome: int) -> None:
        if outcome == OTHER_LAYOUT:
            translated = raw.translated(data)
            raw.unreadable += translated is None
            outcome = FOREIGN if translated is None else join.offer(index, translated)
            if outcome == COMPLETE:
                self._act(join)
        if outcome == FOREIGN:
            raw.foreign += 1
        elif outcome == REPEATED and self.active and self.on_repeat is not None:
            self.on_repeat()

    def _act(self, join: _messages.Join) -> None:
        if not self.active:
            return
        started = time.monotonic_ns()
        tick, statistics = join.tick, self.statistics
        stamp_ns = tick * self._dt_ns
        statistics.age(stamp_ns)
        self._step(tick, stamp_ns)
        statistics.incomplete = join.incomplete
        statistics.tick(tick, started, time.monotonic_ns())

    @property
    def tick(self) -> int:
        """The newest tick seen; -1 before the first."""
        return self.join.tick
