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
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt64

from hd_control._pump import Pump
from hd_control.core import topics
from hd_control.core.errors import BagError, ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.core.resources import config_path
from hd_control.core.topics import JOINT_STATE_TYPE, TOPICS, topic_info
from hd_control.nodes.fast_loop import FastLoop, HandsOff, latched_qos
from hd_control.nodes.process import receiving_priority, run_node
from hd_control.nodes.shell import ERROR, OK, WARN, Shell
from hd_control.record.recorder import AWAITED, Recorder
from hd_control.record.writer import BagWriter

# ---- What is recorded, and the two ways of taking it: a compiled thread, or a loop in Python --------


NEEDED = AWAITED
SETTLE_NS, PATIENT_NS = 200_000_000, 1_500_000_000


def message_class(type_name: str) -> Any:
    """`package/msg/Name` as the Python class."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


class RecordedTopic:
    """One deep subscription that the executor never touches.

    Topics of the chain are only asked for again if they get lost when that is wanted (`reliable`): the control nodes
    keep one message of each, so on the wall clock there is nothing to send again, but every message would be answered.
    """

    def __init__(self, node: Node, name: str, depth: int, group: HandsOff, reliable: bool) -> None:
        known = topic_info(name)
        assert known is not None
        self.name = name
        self.kind = message_class(known.type_name)
        self.chain = known.type_name == JOINT_STATE_TYPE
        self.path = node.resolve_topic_name(name)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if known.latched else DurabilityPolicy.VOLATILE
        asked = reliable or not self.chain
        reliability = ReliabilityPolicy.RELIABLE if asked else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=depth, reliability=reliability, durability=durability)
        self.subscription = node.create_subscription(
            self.kind, name, lambda _: None, qos, callback_group=group, raw=True
        )
        self.take = self.subscription.handle.take_message


def topic_names(extra: Sequence[str]) -> list[str]:
    """Every topic of the schema and the extra ones."""
    return [*TOPICS, *(name for name in extra if name and name not in TOPICS)]


class Taking(Protocol):
    """How samples come from the middleware into a recorder."""

    look_ns: int
    how: str

    def record(self, recorder: Recorder | None) -> None:
        """From now on what comes goes to this recorder; None: it is thrown away, nothing goes to the former one."""

    def collect(self) -> int:
        """Samples of the chain that were taken since the last call."""

    def report(self, recorder: Recorder) -> None:
        """Progress is wanted: publishes the newest tick that is here of every topic, whenever it is a new one."""

    def end(self) -> None:
        """The subscriptions are not used any more."""


class PumpTaking:
    """A compiled thread takes, and reports progress itself (`cpp/pump.hpp`). Raises RuntimeError where it cannot."""

    look_ns, how = 50_000_000, "compiled"

    def __init__(self, topics: Sequence[RecordedTopic], dt_ns: int, progress: Any, paced: bool) -> None:
        self._pump, self._progress, self._seen, self._reporting = Pump(dt_ns), progress, 0, False
        for topic in topics:
            self._pump.add(topic.subscription.handle, topic.chain)
        self._pump.start(rest=paced, priority=receiving_priority())

    def record(self, recorder: Recorder | None) -> None:
        self._pump.record(None if recorder is None else recorder.queues)

    def collect(self) -> int:
        before, self._seen = self._seen, self._pump.taken
        return self._seen - before

    def report(self, recorder: Recorder) -> None:
        if not self._reporting:
            self._pump.report_to(self._progress.handle)
            self._reporting = True

    def end(self) -> None:
        self._pump.end()


class LoopTaking:
    """Takes everything that waits each time it is asked; for a ROS 2 whose entities cannot be used from C++."""

    look_ns = 5_000_000

    def __init__(self, topics: Sequence[RecordedTopic], dt_ns: int, progress: Any, reason: str) -> None:
        self._topics, self._dt_ns, self._progress = tuple(topics), dt_ns, progress
        self.how = f"in Python ({reason})"
        self._recorder: Recorder | None = None
        self._reported_ns = -1

    def record(self, recorder: Recorder | None) -> None:
        self._recorder, self._reported_ns = recorder, -1

    def collect(self) -> int:
        recorder, count = self._recorder, 0
        for topic in self._topics:
            while (taken := topic.take(topic.kind, True)) is not None:
                if recorder is not None:
                    # Only the messages of the chain say who sent them: by their run id.
                    number = taken[1]["publication_sequence_number"] if topic.chain else None
                    recorder.offer(topic.path, time.time_ns(), taken[0], number)
                count += topic.chain
        return count

    def report(self, recorder: Recorder) -> None:
        if (slowest := recorder.newest_ns) > self._reported_ns:
            self._reported_ns = slowest
            self._progress.publish(UInt64(data=(slowest + self._dt_ns // 2) // self._dt_ns))

    def end(self) -> None:
        pass


def taking_of(topics: Sequence[RecordedTopic], dt_ns: int, progress: Any, paced: bool) -> Taking:
    """The compiled way where it can be had. `paced`: ticks come by the clock, not as fast as they can."""
    try:
        return PumpTaking(topics, dt_ns, progress, paced)
    except RuntimeError as error:
        return LoopTaking(topics, dt_ns, progress, str(error))


# ---- The turn of the node's loop -------------------------------------------------------------------


FINISH_NS, QUIET_NS = 1_000_000_000, 100_000_000


class RecorderTurn:
    """One turn of the node's loop: the recorder's duties in time, and its word that it is ready."""

    def __init__(self, loop: FastLoop, topics: Sequence[RecordedTopic], taking: Taking, progress: Any) -> None:
        self._loop, self._topics, self.taking, self._progress = loop, tuple(topics), taking, progress
        self._recorder: Recorder | None = None
        self._announce_at: int | None = None
        self._announced = False

    def __call__(self) -> None:
        self._loop.waiter.wait((), self.taking.look_ns)
        self.collect()

    def record(self, recorder: Recorder | None) -> None:
        """Begins a recording, or ends it: nothing goes to the former recorder when this returns."""
        self.taking.record(recorder)
        self._recorder = recorder

    def finish(self) -> None:
        """Goes on until nothing has come for a while: samples may still be on their way."""
        end = time.monotonic_ns() + FINISH_NS
        quiet_since = time.monotonic_ns()
        while time.monotonic_ns() < min(end, quiet_since + QUIET_NS):
            if self.collect():
                quiet_since = time.monotonic_ns()
            time.sleep(0.005)

    def collect(self) -> int:
        """Lets the recorder do its duties; returns how many samples of the chain came since the last call."""
        count, recorder = self.taking.collect(), self._recorder
        if recorder is not None:
            now = time.monotonic_ns()
            recorder.tend(now)
            if self._announced:
                self.taking.report(recorder)
            else:
                self._announce(now)
        return count

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
            self._progress.publish(UInt64(data=0))


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
        Parameter("reliable", "ask the control nodes again for messages that were lost; for lock-step", kind=bool),
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
        depth, reliable = self.values["depth"], self.values["reliable"]
        self.topics = [RecordedTopic(self, name, depth, self.group, reliable) for name in names]
        taking = taking_of(self.topics, self.dt_ns, self._progress, not reliable)
        self.context.on_shutdown(taking.end)
        self.turn = RecorderTurn(self.loop, self.topics, taking, self._progress)
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
        recorder.write_beside()
        self.recorder = recorder
        if self.turn is not None:
            self.turn.record(recorder)

    def end(self) -> None:
        if self.turn is None or self.recorder is None:
            return
        self.loop.remove()
        self.turn.finish()
        self.turn.record(None)
        end = time.monotonic_ns() + REWRITE_NS
        compact = self.values["compact"]
        failure = self.recorder.close("stopped on request", compact, lambda: time.monotonic_ns() > end)
        if failure:
            self.fault = self.fault or failure
        if not self.loop.stopping:
            self.loop.install(self.turn)

    def dismantle(self) -> None:
        if self.turn is not None:
            self.turn.taking.end()
        for topic in self.topics:
            self.destroy_subscription(topic.subscription)
        self.turn = None

    def destroy_node(self) -> None:
        """Also of a node that was never deactivated: its bag is closed whole."""
        if self.turn is not None:
            self.leave()
        super().destroy_node()

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        recorder = self.recorder
        if recorder is None:
            return OK, "", {}
        table = recorder.statistics()
        values: dict[str, Any] = {"bag": str(recorder.bag.path)}
        if self.turn is not None:
            values["taking"] = self.turn.taking.how
        values |= {f"{name} written": row["written"] for name, row in table.items() if row["written"]}
        dropped = {name: row["drops"] for name, row in table.items() if any(row["drops"].values())}
        values |= {f"{name} dropped": drops for name, drops in dropped.items()}
        values |= {f"{name} never published": n for name, row in table.items() if (n := row["never_published"])}
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
    run_node(RecorderNode, only_receiving=True)


if __name__ == "__main__":
    main()
