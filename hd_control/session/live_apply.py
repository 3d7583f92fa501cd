"""Parameters of running fusion and torque nodes, or of the chain that holds both: read as a whole, set as a whole."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from hd_control.core.errors import HdError
from hd_control.nodes.process import prepare_environment
from hd_control.session.session_client import SessionClient, TrackingWatch

FIND_TIMEOUT, CALL_TIMEOUT = 5.0, 10.0
PARTS = {"fusion_node": "fusion.", "torque_node": "torque."}
"""Prefix of a node's parameters in the chain."""


class LiveNodes:
    """The running nodes of one robot by the names of their parts. Use as a context manager."""

    def __init__(self, namespace: str = "", domain: int | None = None) -> None:
        self._space = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        self._domain, self._namespace = domain, namespace
        self._places: dict[str, tuple[str, str]] = {}

    def __enter__(self) -> LiveNodes:
        prepare_environment()
        self._client = SessionClient(self._namespace, self._domain)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()

    def find(self) -> list[str]:
        """The parts that run. Raises HdError if there is none within 5 s."""
        end = time.monotonic() + FIND_TIMEOUT
        while time.monotonic() < end:
            if self._client.ready(f"{self._space}/chain"):
                self._places = {part: (f"{self._space}/chain", prefix) for part, prefix in PARTS.items()}
                return list(PARTS)
            ready = [part for part in PARTS if self._client.ready(f"{self._space}/{part}")]
            self._places = {part: (f"{self._space}/{part}", "") for part in ready}
            if len(ready) == len(PARTS):
                return ready
            time.sleep(0.05)
        if not self._places:
            raise HdError(
                f"no fusion_node, torque_node or chain answers in namespace {self._space or '/'}; start them with "
                "hd up, or check --namespace and ROS_DOMAIN_ID"
            )
        return list(self._places)

    def watch(self) -> TrackingWatch:
        """Listens to the tracking error from now on."""
        return TrackingWatch(self._client.node)

    def values(self, part: str, names: tuple[str, ...]) -> dict[str, Any]:
        """Present values of a part. Raises HdError."""
        path, prefix = self._places[part]
        found = self._client.get_parameters(path, [prefix + name for name in names], CALL_TIMEOUT)
        return {name.removeprefix(prefix): value for name, value in found.items()}

    def set(self, changes: Mapping[str, Mapping[str, Any]]) -> None:
        """Sets the parameters of each node as a whole. Raises HdError with the reason of a refusal."""
        by_path: dict[str, dict[str, Any]] = {}
        for part, values in changes.items():
            path, prefix = self._places[part]
            by_path.setdefault(path, {}).update({prefix + name: value for name, value in values.items()})
        done: list[str] = []
        for path, values in by_path.items():
            if not values:
                continue
            refused = self._client.set_parameters(path, values, CALL_TIMEOUT)
            if refused:
                already = f"; {', '.join(done)} has taken its part" if done else ""
                raise HdError(f"{path} refused: {refused}{already}")
            done.append(path)
