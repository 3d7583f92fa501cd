"""Runs a robot's node processes from one program: start, configure, activate, talk, stop, collect.

    with Session(RunPlan(lockstep=True, bag=Path("bags/run"))) as session:
        session.activate()
        session.send_goal(goal)
        session.wait_until_tick(5000)
    session.exit_codes

Leaving the block stops every process, also on Ctrl-C. Must be entered from a thread that outlives it.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from hd_control.control.trajectory import Goal
from hd_control.core.errors import GoalError, HdError
from hd_control.nodes.children import Children, child_environment
from hd_control.nodes.process import prepare_environment
from hd_control.nodes.run_plan import NodeProcess, RunPlan

START_TIMEOUT = 30.0
CALL_TIMEOUT = 15.0
RECORDED_TIMEOUT = 5.0
CORE_OF_TWO = {"plant_node": "0", "torque_node": "0", "fusion_node": "1", "motion_node": "1"}


class Session:
    """A running robot. `domain` None keeps the user's domain; `logs` None inherits the terminal."""

    def __init__(
        self, plan: RunPlan, domain: int | None = None, logs: Path | None = None, real_time: bool | None = None
    ) -> None:
        self.plan, self.domain, self.logs = plan, domain, logs
        self.processes: list[NodeProcess] = plan.processes()
        environment = child_environment(domain, not plan.lockstep if real_time is None else real_time)
        self._children = Children(environment)
        self.exit_codes: dict[str, int] = {}
        self._client: Any = None

    # Life ---------------------------------------------------------------------------------------------------------

    def __enter__(self) -> Session:
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Starts the processes and waits until each offers its lifecycle services. Raises HdError if one ends."""
        for process in self.processes:
            options: dict[str, Any] = {}
            if self.logs is not None:
                self.logs.mkdir(parents=True, exist_ok=True)
                stream = (self.logs / f"{process.node}.log").open("wb")
                options = {"stdout": stream, "stderr": stream}
            self._children.start(process.node, process.command(), self._placement(process), **options)
        from hd_control.nodes.session_client import SessionClient

        prepare_environment()
        self._client = SessionClient(self.plan.namespace, self.domain)
        for process in self.processes:
            self._wait(lambda p=process: self.client.ready(p.path), START_TIMEOUT, f"{process.node} offers no services")

    def _placement(self, process: NodeProcess) -> dict[str, str]:
        """Which core and priority a process gets beyond the session's own environment.

        The recorder never runs at real-time priority: it must not delay the chain. With two cores the chain is laid
        out so that two of its four hops do not wake the other core, which can cost more than the work of a node.
        `HD_AFFINITY` of the user goes before.
        """
        found = {"HD_REAL_TIME": "off"} if process.executable == "recorder_node" else {}
        core = CORE_OF_TWO.get(process.executable)
        if os.cpu_count() == 2 and core and not self.plan.lockstep and "HD_AFFINITY" not in os.environ:
            found["HD_AFFINITY"] = core
        return found

    def stop(self) -> dict[str, int]:
        """Stops all processes, the plant first and the recorder last; returns the exit codes. May be called again."""
        try:
            if self._client is not None:
                self._client.close()
                self._client = None
        finally:
            order = [process.node for process in reversed(self.processes) if process.node in self._children.processes]
            last = [process.node for process in self.processes if process.executable == "recorder_node"]
            self.exit_codes = self._children.stop_all(order, last)
        return self.exit_codes

    @property
    def client(self) -> Any:
        """The ROS side of this session."""
        if self._client is None:
            raise HdError("the session is not running; enter it with `with`")
        return self._client

    def pid(self, node: str) -> int:
        """Process id of a node."""
        return self._children.processes[node].pid

    def kill(self, node: str, number: int) -> None:
        """Sends a signal to one node's process (tests and demonstrations of faults)."""
        self._children.signal(node, number)

    def alive(self, node: str) -> bool:
        """True while the node's process runs."""
        return self._children.processes[node].poll() is None

    def log(self, node: str) -> str:
        """What a node printed, if `logs` was given."""
        path = self.logs / f"{node}.log" if self.logs is not None else None
        return path.read_text(errors="replace") if path is not None and path.exists() else ""

    # Talk ---------------------------------------------------------------------------------------------------------

    def activate(self) -> None:
        """Configures all nodes at once, then activates them in order, the plant last."""
        self.client.transition([process.path for process in self.processes], "configure", CALL_TIMEOUT)
        self.activate_again()

    def activate_again(self) -> None:
        """Activates configured nodes in order, the plant last."""
        for process in self.processes:
            self.client.transition([process.path], "activate", CALL_TIMEOUT)

    def deactivate(self) -> None:
        """Deactivates all nodes, the plant first."""
        for process in reversed(self.processes):
            self.client.transition([process.path], "deactivate", CALL_TIMEOUT)

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> str:
        """Changes parameters of one node as a whole; returns the reason of a refusal, empty if accepted."""
        return str(self.client.set_parameters(self._path(node), values, CALL_TIMEOUT))

    def get_parameters(self, node: str, names: list[str] | None = None) -> dict[str, Any]:
        """Values of a node's parameters, all if no names are given."""
        found: dict[str, Any] = self.client.get_parameters(self._path(node), names, CALL_TIMEOUT)
        return found

    def reset(self, node: str) -> str:
        """Calls `~/reset`; returns the reasons of a refusal, empty if granted."""
        return str(self.client.reset(self._path(node), CALL_TIMEOUT))

    def send_goal(self, goal: Goal, period: float = 1e-3, timeout: float = CALL_TIMEOUT) -> str:
        """Publishes a goal and waits for the answer; returns the acceptance text. Raises GoalError if refused."""
        answer: str = self.client.send_goal(goal, round(period * 1e9), timeout)
        if answer.startswith("refused"):
            _, _, code, text = answer.split(" ", 3)
            raise GoalError(code.rstrip(":"), text)
        return answer

    def tick(self) -> int:
        """The next tick of the plant as it last told; -1 before the first word."""
        return int(self.client.tick)

    def wait_until_tick(self, tick: int, timeout: float = 60.0) -> None:
        """Waits until the plant has come to `tick` (told every 50 ticks and when it stands still)."""
        self._wait(lambda: self.tick() >= tick, timeout, f"the plant did not come to tick {tick}")

    def run_to(self, tick: int, timeout: float = 60.0) -> None:
        """Lock-step: lets the plant run and stand still before `tick`."""
        refused = self.set_parameters(self.plant_node, {"pause_at_tick": tick})
        if refused:
            raise HdError(refused)
        self.wait_until_tick(tick, timeout)
        self._wait_recorded(tick)

    def _wait_recorded(self, tick: int) -> None:
        """Waits a while until the recorder has sensors and commands up to `tick`; without commands it never has."""
        end = time.monotonic() + RECORDED_TIMEOUT
        while self.plan.bag is not None and self.client.recorded < tick - 1 and time.monotonic() < end:
            time.sleep(0.005)

    @property
    def plant_node(self) -> str:
        """The node that runs the plant."""
        return "plant_node" if "plant_node" in self.plan.nodes else "chain"

    def diagnostics(self, node: str) -> dict[str, str]:
        """The newest diagnostics of a node as texts, with `level` and `message`; empty before the first."""
        return dict(self.client.diagnostics.get(self._path(node), {}))

    def fresh_diagnostics(self, node: str, timeout: float = CALL_TIMEOUT) -> dict[str, str]:
        """Diagnostics that were made after this call, also when nothing in them has changed since."""
        heard, path = self.client.diagnostics_heard, self._path(node)
        wanted = heard.get(path, 0) + 2  # the next may have been on its way already
        self._wait(lambda: heard.get(path, 0) >= wanted, timeout, f"no new diagnostics of {node}")
        return self.diagnostics(node)

    def stay(self, ticks: int = 0) -> None:
        """Returns after `ticks` more ticks of the plant; 0: never. Raises HdError if a node ends."""
        first: int | None = None

        def done() -> bool:
            nonlocal first
            first = self.tick() if first is None and self.tick() >= 0 else first
            return ticks > 0 and first is not None and self.tick() - first >= ticks

        self._wait(done, math.inf, "")

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Waits for anything else. Raises HdError with `what` at the timeout."""
        self._wait(condition, timeout, what)

    def _path(self, node: str) -> str:
        return next(process.path for process in self.processes if process.node == node)

    def _wait(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        end = time.monotonic() + timeout
        while not condition():
            dead = list(self._children.dead())
            if dead and not self._expect_deaths:
                lines = self.log(dead[0]).strip().splitlines()
                raise HdError(f"{dead[0]} ended: {lines[-1] if lines else 'see its output'}")
            if time.monotonic() > end:
                raise HdError(f"{what} within {timeout:g} s")
            time.sleep(0.005)

    _expect_deaths = False

    def expect_deaths(self) -> None:
        """From now on the end of a process is no error (tests that kill one)."""
        self._expect_deaths = True


def log_folder() -> Path:
    """A new folder for the output of node processes."""
    return Path(tempfile.mkdtemp(prefix="hd_logs_"))
