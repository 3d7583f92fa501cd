"""`recorder_node`: every topic of the chain into an MCAP bag; what is lost is counted and stored with the data.

A disk error ends the recording and shows as ERROR in the diagnostics; control is not touched. SIGINT closes the bag.
Exit codes: 0 stopped on request, 1 internal fault or a recording that failed, 2 bad configuration.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from std_msgs.msg import UInt64

from hd_control.core.errors import BagError, ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.core.resources import config_path
from hd_control.nodes.lifecycle_shell import ERROR, OK, WARN, Shell
from hd_control.nodes.process import run_node
from hd_control.nodes.recorder_turn import RecordedTopic, RecorderTurn, topic_names
from hd_control.nodes.ros_loop import latched_qos
from hd_control.record.recorder import Recorder
from hd_control.record.schema import topic_info
from hd_control.record.writer import BagWriter
from hd_control.stages import topics

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
        return (WARN, f"samples lost on {', '.join(dropped)}", values) if dropped else (OK, "recording", values)

    def _notes(self) -> dict[str, str]:
        pairs = (text.partition("=") for text in self.values["notes"] if text)
        return {"recorder_run_id": self.run_id, "period": f"{self.dt:g}"} | {key: value for key, _, value in pairs}


def main() -> None:
    """Entry point; ends the process with the exit code."""
    run_node(RecorderNode)


if __name__ == "__main__":
    main()
