"""`recorder_node`: every topic of the chain into an MCAP bag; what is lost is counted and stored with the data.

A fast loop takes the serialised messages, writes them and reports its progress. A disk error ends the recording and
shows as ERROR in the diagnostics; control is not touched. SIGINT closes the bag. Exit codes: 0 stopped on request,
1 internal fault or a recording that failed, 2 bad configuration.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt64

from hd_control.core import topics
from hd_control.core.errors import BagError, ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.core.resources import config_path
from hd_control.core.topics import COMMAND, JOINT_STATE_TYPE, SENSORS, TOPICS, topic_info
from hd_control.nodes.fast_loop import FastLoop, HandsOff, latched_qos
from hd_control.nodes.process import run_node
from hd_control.nodes.shell import ERROR, OK, WARN, Shell
from hd_control.record.recorder import Recorder
from hd_control.record.writer import BagWriter

# ---- The fast loop ---------------------------------------------------------------------------------


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
        self.chain = known.type_name == JOINT_STATE_TYPE
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
        self, loop: FastLoop, topics: Sequence[RecordedTopic], dt_ns: int, progress: Callable[[int], None]
    ) -> None:
        self._loop, self._topics, self._half, self._dt_ns, self._progress = (
            loop,
            tuple(topics),
            dt_ns // 2,
            dt_ns,
            progress,
        )
        self.recorder: Recorder | None = None
        self._reported = -1
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
        elif (slowest := min(self._newest_ns.values())) > self._reported:
            self._reported = slowest
            self._progress((slowest + self._half) // self._dt_ns)
        return taken_count

    def _announce(self, now: int) -> None:
        """Reports `0` once a plant and a torque node are seen: a lock-step plant that wants no loss waits for this."""
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
            self._progress(0)

    def _note(self, path: str, data: bytes) -> None:
        """The newest stamp of each topic. What is reported is the slowest: a topic ahead says nothing of the others."""
        seconds, nanoseconds = int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")
        self._newest_ns[path] = max(self._newest_ns.get(path, -1), seconds * 1_000_000_000 + nanoseconds)


# ---- The node --------------------------------------------------------------------------------------


REWRITE_NS = 500_000_000
"""A rewrite that takes longer is given up, the plain file stays: a signal ends the node within 2 s."""
ATTACHED = ("nodes.yaml", "fusion_node.yaml", "motion_node.yaml", "torque_node.yaml", "limits.yaml")


def _extra_rule(values: Any) -> list[str]:
    return [
        f"extra_topics: {name!r} is not a topic of this package"
        for name in filter(None, values["extra_topics"])
        if topic_info(name) is None
    ]


PARAMETERS = ParameterSet(
    "recorder_node",
    (
        Parameter("bag", "path of the new bag; empty: bags/<date and time>", kind=str),
        Parameter("depth", "messages kept by the middleware for each topic", kind=int, low=10, high=100_000),
        Parameter("extra_topics", "more topics to record", kind=str, shape=Shape.LIST),
        Parameter("attach", "more files to carry in the bag", kind=str, shape=Shape.LIST),
        Parameter("notes", "key=value texts for the session record", kind=str, shape=Shape.LIST),
        Parameter("compact", "rewrite into compressed chunks at the end", kind=bool, change=Change.HOT),
    ),
    (_extra_rule,),
)


class RecorderNode(Shell):
    """Queues and a bag; its own process, so that a slow disk never touches the control."""

    def __init__(self) -> None:
        self.turn: RecorderTurn | None = None
        self.recorder: Recorder | None = None
        super().__init__("recorder_node", PARAMETERS)
        self._progress = self.create_publisher(UInt64, topics.PROGRESS, latched_qos())

    def build(self) -> Callable[[], None]:
        names = topic_names(self.values["extra_topics"])
        self.topics = [RecordedTopic(self, name, self.values["depth"], self.group) for name in names]
        self.turn = RecorderTurn(
            self.loop, self.topics, self.dt_ns, lambda tick: self._progress.publish(UInt64(data=tick))
        )
        return self.turn

    def begin(self) -> None:
        path = Path(self.values["bag"] or f"bags/{time.strftime('%Y-%m-%d_%H-%M-%S')}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            bag = BagWriter(path, compact=self.values["compact"], metadata=self._notes())
            recorder = Recorder(bag, queue_depth=self.values["depth"], total_depth=20 * self.values["depth"])
            for topic in self.topics:
                recorder.add_topic(topic.path)
            bag.attach("robot.urdf", self.robot.urdf, "application/xml")
            for name in ATTACHED:
                bag.attach_file(config_path(name))
            for name in filter(None, self.values["attach"]):
                bag.attach_file(name)
        except (BagError, OSError) as error:
            raise ConfigError(f"recorder_node: {error}") from None
        self.get_logger().info(f"recording into {path}")
        self.recorder = recorder
        if self.turn is not None:
            self.turn.recorder = recorder

    def end(self) -> None:
        if self.turn is None or self.recorder is None:
            return
        self.loop.remove()
        self.turn.finish()
        self.turn.recorder = None
        end = time.monotonic_ns() + REWRITE_NS
        compact = self.values["compact"]
        failure = self.recorder.close("stopped on request", compact, lambda: time.monotonic_ns() > end)
        if failure:
            self.fault = self.fault or failure
        if not self.loop.stopping:
            self.loop.install(self.turn)

    def dismantle(self) -> None:
        for topic in self.topics:
            self.destroy_subscription(topic.subscription)
        self.turn = None

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        recorder = self.recorder
        if recorder is None:
            return OK, "", {}
        table = recorder.statistics()
        values: dict[str, Any] = {"bag": str(recorder.bag.path)}
        values |= {f"{name} written": row["written"] for name, row in table.items() if row["written"]}
        dropped = {name: row["drops"] for name, row in table.items() if any(row["drops"].values())}
        values |= {f"{name} dropped": drops for name, drops in dropped.items()}
        if recorder.failure:
            self.fault = self.fault or recorder.failure
            return ERROR, recorder.failure, values
        if recorder.warning:
            return WARN, recorder.warning, values
        losses = recorder.losses()
        return (WARN, losses, values) if losses else (OK, "recording", values)

    def _notes(self) -> dict[str, str]:
        pairs = (text.partition("=") for text in self.values["notes"] if text)
        return {"recorder_run_id": self.run_id, "period": f"{self.dt:g}"} | {key: value for key, _, value in pairs}


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(RecorderNode)


if __name__ == "__main__":
    main()
