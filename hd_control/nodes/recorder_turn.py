"""The recorder's fast loop: takes serialised messages of every topic, writes them, tells its progress."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from hd_control.nodes.ros_loop import FastLoop, HandsOff
from hd_control.record.cdr import JOINT_STATE
from hd_control.record.recorder import Recorder
from hd_control.record.schema import TOPICS, topic_info
from hd_control.stages.topics import COMMAND, SENSORS

BATCH_NS = 5_000_000
FINISH_NS, QUIET_NS = 1_000_000_000, 100_000_000
SETTLE_NS, PATIENT_NS = 200_000_000, 1_500_000_000
NEEDED = (*SENSORS, COMMAND)


def message_class(type_name: str) -> Any:
    """`package/msg/Name` as the Python class."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


class RecordedTopic:
    """One subscription, deep and reliable, that the executor never touches."""

    def __init__(self, node: Node, name: str, depth: int, group: HandsOff) -> None:
        known = topic_info(name)
        assert known is not None
        self.name = name
        self.kind = message_class(known.type_name)
        self.chain = known.type_name == JOINT_STATE
        self.path = node.resolve_topic_name(name)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if known.latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        self.subscription = node.create_subscription(
            self.kind, name, lambda _: None, qos, callback_group=group, raw=True
        )
        self.take = self.subscription.handle.take_message


def topic_names(extra: Sequence[str]) -> list[str]:
    """Every topic of the schema and the extra ones."""
    return [*TOPICS, *(name for name in extra if name and name not in TOPICS)]


class RecorderTurn:
    """Every 5 ms: take all that is waiting and let the recorder write it."""

    def __init__(
        self, loop: FastLoop, topics: Sequence[RecordedTopic], dt_ns: int, tell: Callable[[int], None]
    ) -> None:
        self._loop, self._topics, self._half, self._dt_ns, self._tell = loop, tuple(topics), dt_ns // 2, dt_ns, tell
        self.recorder: Recorder | None = None
        self._told = -1
        self._newest_ns = {topic.path: -1 for topic in self._topics if topic.name in NEEDED}
        self._announce_at: int | None = None
        self._announced = False

    def __call__(self) -> None:
        self._loop.waiter.wait((), BATCH_NS)
        self.collect()

    def finish(self) -> None:
        """Goes on until nothing has come for a while: samples may still be on their way."""
        end = time.monotonic_ns() + FINISH_NS
        quiet_since = time.monotonic_ns()
        while time.monotonic_ns() < min(end, quiet_since + QUIET_NS):
            if self.collect():
                quiet_since = time.monotonic_ns()
            time.sleep(0.002)

    def collect(self) -> int:
        """Takes and writes everything that is waiting; returns how many samples of the chain there were."""
        recorder, taken_count = self.recorder, 0
        for topic in self._topics:
            while (taken := topic.take(topic.kind, True)) is not None:
                if recorder is not None:
                    recorder.offer(topic.path, time.time_ns(), taken[0])
                    if topic.chain:
                        taken_count += 1
                        self._note(topic.path, taken[0])
        if recorder is None:
            return taken_count
        now = time.monotonic_ns()
        recorder.tend(now)
        if not self._announced:
            self._announce(now)
        elif (slowest := min(self._newest_ns.values())) > self._told:
            self._told = slowest
            self._tell((slowest + self._half) // self._dt_ns)
        return taken_count

    def _announce(self, now: int) -> None:
        """Tells `0` once a plant and a torque node are seen: a lock-step plant that wants no loss waits for this."""
        ready = all(topic.subscription.handle.get_publisher_count() for topic in self._topics if topic.name in NEEDED)
        if not ready:
            self._announce_at = None
            return
        # Topics of a node that is not there never come; once all are seen the rest of that wait is not needed.
        whole = all(topic.subscription.handle.get_publisher_count() for topic in self._topics if topic.chain)
        latest = now + (SETTLE_NS if whole else PATIENT_NS)
        self._announce_at = latest if self._announce_at is None else min(self._announce_at, latest)
        if now >= self._announce_at:
            self._announced = True
            self._tell(0)

    def _note(self, path: str, data: bytes) -> None:
        """The newest stamp of each topic. What is told is the slowest: a topic ahead says nothing of the others."""
        seconds, nanoseconds = int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")
        self._newest_ns[path] = max(self._newest_ns.get(path, -1), seconds * 1_000_000_000 + nanoseconds)
