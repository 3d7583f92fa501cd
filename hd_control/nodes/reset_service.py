"""`~/reset` (std_srvs/Trigger): asked in the executor thread, answered between two ticks of the loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.node import Node
from std_srvs.srv import Trigger

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
