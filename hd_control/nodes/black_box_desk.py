"""Black boxes of a node: a thread outside the loop takes what a stop has left and writes it as bags.

`~/black_box` (std_srvs/Trigger) writes at once what is still in memory, and answers with the newest bag or with the
reason why the disk refuses. Refused incidents stay in memory and are tried again.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_srvs.srv import Trigger

from hd_control.core.errors import BagError
from hd_control.core.parameters import Change, Parameter
from hd_control.core.params_file import params_text
from hd_control.record.black_box_files import KEPT, Incident, Origin, write_incident
from hd_control.stages.black_box import BlackBox

if TYPE_CHECKING:
    from hd_control.nodes.lifecycle_shell import Shell

BLACK_BOX = (
    Parameter("black_box", "write the last seconds before and after a stop as a bag", kind=bool, change=Change.HOT),
    Parameter("black_box_folder", "folder of these bags; every node makes its own in it", kind=str, change=Change.HOT),
)
LOOK, RETRY, SILENCE = 0.2, 5.0, 1.5
"""s between two looks, between two tries on a disk that refuses, and without a tick until an incident is written."""


Boxes = Callable[[], Mapping[str, BlackBox]]
"""The boxes of a node by the folder below the node's own, "" for the node's own."""


class BlackBoxDesk:
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


def serve_black_box(node: Shell, boxes: Boxes) -> BlackBoxDesk:
    """The desk of a node and its service."""
    desk = BlackBoxDesk(node, boxes)
    node.create_service(Trigger, "~/black_box", desk.answer)
    return desk
