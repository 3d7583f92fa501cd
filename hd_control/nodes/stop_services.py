"""What a node offers around a stop: its black boxes, its mode, its reset.

`~/black_box` (std_srvs/Trigger) writes at once what is still in memory, and answers with the newest bag or with the
reason why the disk refuses. A thread outside the loop writes what a stop has left; refused incidents stay in memory and
are tried again. `torque_mode` carries the mode of each torque node when it changes, `torque_node DEGRADED`; the motion
node listens. `~/reset` (std_srvs/Trigger) is asked in the executor thread and answered between two ticks of the loop.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from hd_control import _plane
from hd_control.chain.black_box import BlackBox
from hd_control.chain.motion_stage import MODES, MotionStage
from hd_control.chain.torque_stage import TorqueStage
from hd_control.core import topics
from hd_control.core.errors import BagError
from hd_control.core.parameters import Change, Parameter, params_text
from hd_control.nodes.fast_loop import latched_qos
from hd_control.record.black_box_files import KEPT, Incident, Origin, write_incident
from hd_control.record.cdr import encode_text

if TYPE_CHECKING:
    from hd_control.nodes.shell import Shell


BLACK_BOX = (
    Parameter("black_box", "write the last seconds before and after a stop as a bag", kind=bool, change=Change.HOT),
    Parameter("black_box_folder", "folder of these bags; every node makes its own in it", kind=str, change=Change.HOT),
)
LOOK, RETRY, SILENCE = 0.2, 5.0, 1.5
"""s between two looks, between two tries on a disk that refuses, and without a tick until an incident is written."""


Boxes = Callable[[], Mapping[str, BlackBox]]
"""The boxes of a node by the folder below the node's own, "" for the node's own."""


class BlackBoxService:
    """Writes the incidents of the boxes of a node; `stop` writes what is left."""

    def __init__(self, node: Shell, boxes: Boxes) -> None:
        self._node, self._boxes = node, boxes
        self._pending: list[tuple[str, Incident]] = []
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self.written, self.newest, self.failure = 0, "", ""
        self._next_try = 0.0
        self._seen: dict[str, tuple[int, float]] = {}
        self._thread = threading.Thread(target=self._serve, name="black box", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread and writes what is there."""
        self._ending.set()
        self._thread.join(2.0)
        self.collect(True)

    def collect(self, all_of_them: bool) -> None:
        """Takes finished incidents, `all_of_them` or unfinished ones too, and writes what can be written."""
        with self._lock:
            for part, box in self._boxes().items():
                self._pending += [(part, each) for each in box.take(all_of_them or self._silent(part, box))]
            del self._pending[:-KEPT]
            values = self._node.values
            if self._pending and values["black_box"]:
                self._write(Path(values["black_box_folder"]))

    def values(self) -> dict[str, Any]:
        """For diagnostics."""
        found = {"black_boxes_written": self.written, "black_box": self.newest}
        return found | {"black_boxes_in_memory": len(self._pending), "black_box_failure": self.failure}

    def answer(self, request: Any, response: Trigger.Response) -> Trigger.Response:
        """The service: tries now."""
        self.collect(True)
        response.success = not self._pending
        response.message = self.newest or "no stop yet"
        if self._pending:
            why = self.failure or "parameter black_box is false"
            response.message = f"{len(self._pending)} black boxes stay in memory: {why}"
        return response

    def _silent(self, part: str, box: BlackBox) -> bool:
        """No tick came for a while although a stop waits for rows."""
        now = time.monotonic()
        written, since = self._seen.get(part, (-1, now))
        if not box.waits or box.written != written:
            self._seen[part] = box.written, now
            return False
        return now - since > SILENCE

    def _write(self, folder: Path) -> None:
        node = self._node
        name = node.get_fully_qualified_name()
        origin = Origin(name, node.run_id, node.dt_ns, node.robot.urdf, params_text(node.values))
        while self._pending:
            part, incident = self._pending[0]
            try:
                path = write_incident(folder / name.strip("/") / part, incident, origin)
            except BagError as error:
                self.failure = str(error)
                return
            self.newest, self.failure, self.written = str(path), "", self.written + 1
            del self._pending[0]

    def _serve(self) -> None:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # below the loop, whatever the process has
        while not self._ending.wait(LOOK):
            if self.failure and time.monotonic() < self._next_try:
                continue
            self._next_try = time.monotonic() + RETRY
            try:
                self.collect(False)
            except Exception as error:  # never the end of a node that has just stopped a robot
                self.failure = f"{type(error).__name__}: {error}"


def serve_black_box(node: Shell, boxes: Boxes) -> BlackBoxService:
    """Starts the service of a node's black boxes."""
    service = BlackBoxService(node, boxes)
    node.create_service(Trigger, "~/black_box", service.answer)
    return service


# ---- The mode --------------------------------------------------------------------------------------
#
# Modes: INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING, STOPPED (docs/safety.md). Latched, so who comes late knows, too.


NODES = 32
"""Torque nodes that may publish their mode at the same time."""


class ModePublisher:
    """Publishes the mode of one torque law when it changes."""

    def __init__(self, node: Shell) -> None:
        self._name = node.get_fully_qualified_name()
        self._publisher = node.create_publisher(String, topics.MODE, latched_qos())

    def announce(self, plane: _plane.Loop, program: _plane.Program, stage: TorqueStage) -> None:
        """The mode after this place of a loop's list."""
        texts = [encode_text(f"{self._name} {mode}") for mode in MODES]
        outbox = plane.outbox(self._publisher.handle, texts[0], _plane.NO_STAMP, [])
        program.announce(outbox, stage.native.mode_capsule(), [b"", *texts])


class ModeInput:
    """Keeps the worst mode of all torque nodes where the motion law looks."""

    def __init__(self, node: Shell, stage: MotionStage) -> None:
        self._stage = stage
        self._modes: dict[str, str] = {}
        latched = DurabilityPolicy.TRANSIENT_LOCAL
        qos = QoSProfile(depth=NODES, reliability=ReliabilityPolicy.RELIABLE, durability=latched)
        node.create_subscription(String, topics.MODE, self._take, qos)

    def _take(self, message: String) -> None:
        name, _, mode = message.data.partition(" ")
        if mode in MODES:
            self._modes[name] = mode
            self._stage.controller_mode = max(self._modes.values(), key=MODES.index)


def follow_drives(node: Shell, stage: MotionStage) -> None:
    """Keeps the state of the drives where the motion law looks."""

    def take(message: String) -> None:
        stage.drive_state = message.data if message.data in topics.DRIVE_STATES else ""

    node.create_subscription(String, topics.DRIVES, take, latched_qos())


# ---- The reset -------------------------------------------------------------------------------------


WAIT = 1.0


class Resettable(Protocol):
    """The loop sees `reset_asked`, tries, and puts the reasons of a refusal (none: granted) into `reset_answer`."""

    reset_asked: bool
    reset_answer: list[str] | None


def serve_reset(node: Node, find: Callable[[], Resettable | None]) -> None:
    """Creates the service for what `find` returns (None: not configured). A refusal lists every reason."""

    def answer(request: Any, response: Trigger.Response) -> Trigger.Response:
        target = find()
        if target is None:
            response.success, response.message = False, "not configured"
            return response
        target.reset_answer, target.reset_asked = None, True
        end = time.monotonic() + WAIT
        while target.reset_answer is None and time.monotonic() < end:
            time.sleep(0.002)
        target.reset_asked = False
        reasons = (
            ["no ticks arrive; start the plant or the bridge"] if target.reset_answer is None else target.reset_answer
        )
        response.success, response.message = not reasons, "; ".join(reasons) or "reset"
        return response

    node.create_service(Trigger, "~/reset", answer)
