"""Child processes that never outlive us: own process groups, SIGTERM first, SIGKILL last, no orphan on Ctrl-C."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from hd_control.nodes.process import DISCOVERY

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
GRACE = (10.0, 2.0, 2.0)
"""s after SIGTERM, SIGINT and SIGKILL; the first is longer than a node's own limit (process.STOP_LIMIT)."""
LAST_GRACE = 3.0


def child_environment(domain: int | None = None, real_time: bool = True) -> dict[str, str]:
    """Environment of node processes: discovery on this computer only, its own domain, priority on request."""
    environment = dict(os.environ)
    environment.setdefault(DISCOVERY, "LOCALHOST")
    root = str(Path(__file__).resolve().parents[2])
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, environment.get("PYTHONPATH", "")]))
    if domain is not None:
        environment["ROS_DOMAIN_ID"] = str(domain)
    if not real_time:
        environment["HD_REAL_TIME"] = "off"
    return environment


def _die_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Children:
    """Processes by name, started in their own groups; leaving the `with` block stops them all."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)
        self.processes: dict[str, subprocess.Popen[Any]] = {}

    def start(
        self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None, **options: Any
    ) -> subprocess.Popen[Any]:
        """Starts one child, with its own additions to the environment. It gets SIGTERM if this process dies."""
        own = {**self._environment, **(environment or {})}
        process = subprocess.Popen(
            list(command), env=own, start_new_session=True, preexec_fn=_die_with_parent, **options
        )
        self.processes[name] = process
        return process

    def dead(self) -> dict[str, int]:
        """Exit codes of the children that have ended."""
        return {name: p.returncode for name, p in self.processes.items() if p.poll() is not None}

    def stop(self, order: Sequence[str] = (), last: Sequence[str] = ()) -> dict[str, int]:
        """SIGTERM to all, those of `order` first, then SIGINT, then SIGKILL; returns every exit code.

        SIGTERM goes first because a process that is still importing ends on it without a traceback. Those of `last` go
        on until all others have ended, at most `LAST_GRACE`: a recorder hears the last words of the others.
        """
        others = list(dict.fromkeys(name for name in (*order, *self.processes) if name not in last))
        if last:
            self._send(others, signal.SIGTERM, LAST_GRACE)
        names = [*others, *(name for name in last if name in self.processes)]
        for number, grace in zip((signal.SIGTERM, signal.SIGINT, signal.SIGKILL), GRACE, strict=True):
            if self._send(names, number, grace):
                break
        return self.dead()

    def _send(self, names: Sequence[str], number: int, grace: float) -> bool:
        """Sends a signal to some children and waits for their end; True if all have ended."""
        for name in names:
            self.signal(name, number)
        end = time.monotonic() + grace
        while not (gone := set(names) <= set(self.dead())) and time.monotonic() < end:
            time.sleep(0.01)
        return gone

    def stop_all(self, order: Sequence[str] = (), last: Sequence[str] = ()) -> dict[str, int]:
        """Like `stop`, and an impatient Ctrl-C does not end it early: our children must not stay."""
        while True:
            try:
                return self.stop(order, last)
            except KeyboardInterrupt:
                continue

    def signal(self, name: str, number: int) -> None:
        """Sends a signal to one child that is still ours and alive."""
        process = self.processes[name]
        if process.poll() is None:
            process.send_signal(number)

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop_all()
