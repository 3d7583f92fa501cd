"""Runs a robot's node processes from one program: start, configure, activate, talk, stop, collect.

    with Session(RunPlan(lockstep=True, bag=Path("bags/run"))) as session:
        session.activate()
        session.send_goal(goal)
        session.wait_until_tick(5000)
    session.exit_codes

A `RunPlan` says which processes a robot needs, with which parameters; `hd up` and the launch file use it, too. Leaving
the block stops every process, also on Ctrl-C. Must be entered from a thread that outlives it.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from hd_control.chain.motion_stage import NOT_ARMED, NOT_ARMED_CODE
from hd_control.core.errors import ConfigError, GoalError, HdError
from hd_control.core.topics import ARMED, DRIVES_STOPPED
from hd_control.laws.trajectory import Goal
from hd_control.nodes.process import DISCOVERY, prepare_environment

# ---- Child processes that never outlive us: own process groups, SIGTERM first, SIGKILL last, no orphan on Ctrl-C ----


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


# ---- The plan --------------------------------------------------------------------------------------


MODULES = {
    "recorder_node": "hd_control.nodes.recorder_node",
    "torque_node": "hd_control.nodes.torque_node",
    "motion_node": "hd_control.nodes.motion_node",
    "fusion_node": "hd_control.nodes.fusion_node",
    "chain": "hd_sim.nodes.chain",
    "plant_node": "hd_sim.nodes.plant_node",
}
"""In the order of activation: a node finds its consumers awake, the plant comes last."""
FOUR = ("torque_node", "motion_node", "fusion_node", "plant_node")
RECORDER_LAG = 200
"""Ticks by which a plant in lock-step may run ahead of the recorder."""


@dataclass(frozen=True)
class RunPlan:
    """A robot's node processes. `parameters` and `params_files` are by node name, `plant` a shipped name or a path.

    `joint_groups` runs one torque node for each group of joint names, called torque_node_1 and so on.
    """

    nodes: tuple[str, ...] = FOUR
    plant: str = "arm_a"
    robot: str = ""
    lockstep: bool = False
    namespace: str = ""
    bag: Path | None = None
    joint_groups: tuple[tuple[str, ...], ...] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    params_files: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unknown = [name for name in self.nodes if name not in MODULES]
        if unknown:
            raise ConfigError(f"no node {unknown[0]!r}; there is {', '.join(MODULES)}")

    def processes(self) -> list[NodeProcess]:
        """The processes in the order of activation."""
        wanted = [
            *self.nodes,
            *(["recorder_node"] if self.bag is not None and "recorder_node" not in self.nodes else []),
        ]
        found = []
        for name in sorted(wanted, key=list(MODULES).index):
            if name == "torque_node" and self.joint_groups:
                for number, joints in enumerate(self.joint_groups, 1):
                    found.append(self._process(name, f"{name}_{number}", {"joints": list(joints)}))
            else:
                found.append(self._process(name, name, {}))
        return found

    def _process(self, executable: str, node: str, own: Mapping[str, Any]) -> NodeProcess:
        values: dict[str, Any] = {}
        if executable == "plant_node" or (executable == "chain" and "plant_node" not in self.nodes):
            values |= {"plant": self.plant, "clock": "lockstep" if self.lockstep else "wall"}
            if self.lockstep and self.bag is not None:
                values["lockstep_recorder_lag"] = RECORDER_LAG
        if executable == "chain" and "plant_node" not in self.nodes:
            values["with_plant"] = True
        if executable != "plant_node" and "with_plant" not in values:
            values["robot"] = self.robot or self.plant
        if self.lockstep and self.bag is not None:
            values["publisher_depth"] = 2 * RECORDER_LAG
        if executable == "recorder_node" and self.bag is not None:
            values |= {"bag": str(self.bag), "reliable": self.lockstep}
        values |= own | dict(self.parameters.get(executable, {}))
        return NodeProcess(executable, node, self.namespace, values, self.params_files.get(executable, ()))


@dataclass(frozen=True)
class NodeProcess:
    """One process: its executable, its node's name and namespace, and its parameters."""

    executable: str
    node: str
    namespace: str
    parameters: Mapping[str, Any]
    params_files: tuple[Path, ...] = ()

    @property
    def path(self) -> str:
        """The node's full name."""
        return f"/{self.namespace.strip('/')}/{self.node}" if self.namespace.strip("/") else f"/{self.node}"

    def ros_arguments(self) -> list[str]:
        """What follows the executable on its command line."""
        arguments = ["--ros-args", "-r", f"__node:={self.node}"]
        if self.namespace.strip("/"):
            arguments += ["-r", f"__ns:=/{self.namespace.strip('/')}"]
        for path in self.params_files:
            arguments += ["--params-file", str(path)]
        for name, value in self.parameters.items():
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
        return arguments

    def command(self) -> list[str]:
        """The command line of the process."""
        return [sys.executable, "-m", MODULES[self.executable], *self.ros_arguments()]


# ---- The session -----------------------------------------------------------------------------------


START_TIMEOUT = 30.0
CALL_TIMEOUT = 15.0
TRANSITION_TIMEOUT = 60.0
"""s; a node that is configured loads its laws, and on a busy machine seven of them share two processors."""
RECORDED_TIMEOUT = 5.0
ARM_TIMEOUT = 20.0
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
        from hd_control.session.session_client import SessionClient

        prepare_environment()
        self._client = SessionClient(self.plan.namespace, self.domain)
        for process in self.processes:
            self._wait(lambda p=process: self.client.ready(p.path), START_TIMEOUT, f"{process.node} offers no services")

    def _placement(self, process: NodeProcess) -> dict[str, str]:
        """Which core and priority a process gets beyond the session's own environment.

        With two cores the chain is laid out so that two of its four hops do not wake the other core, which can cost
        more than the work of a node. `HD_AFFINITY` of the user goes before.
        """
        found = {}
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

    def log(self, node: str) -> str:
        """What a node printed, if `logs` was given."""
        path = self.logs / f"{node}.log" if self.logs is not None else None
        return path.read_text(errors="replace") if path is not None and path.exists() else ""

    # Talk ---------------------------------------------------------------------------------------------------------

    def activate(self) -> None:
        """Configures all nodes at once, then activates them in order, the plant last."""
        self.configure()
        self.activate_again()

    def configure(self) -> None:
        """Configures all nodes at once."""
        self.client.transition([process.path for process in self.processes], "configure", TRANSITION_TIMEOUT)

    def activate_again(self) -> None:
        """Activates configured nodes in order, the plant last."""
        for process in self.processes:
            self.client.transition([process.path], "activate", TRANSITION_TIMEOUT)

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

    def wait_until_armed(self, timeout: float = ARM_TIMEOUT) -> None:
        """Waits until the drives obey. Raises HdError with what stands in the way."""
        if reason := self.arming(timeout):
            raise HdError(reason)

    def arming(self, timeout: float = ARM_TIMEOUT) -> str:
        """Waits until the drives obey; empty then, else what stands in the way. Raises HdError if a node ends."""
        end = time.monotonic() + timeout
        self._wait(lambda: self.client.drive_state == ARMED or time.monotonic() > end, math.inf, "")
        return "" if self.client.drive_state == ARMED else f"not armed within {timeout:g} s: {self._not_armed()}"

    def _not_armed(self) -> str:
        """Why the drives do not obey, from what they and the nodes say."""
        state = self.client.drive_state or f"{self.plant_node} says nothing"
        why = NOT_ARMED.get(state, "")
        nodes = [(process.node, self.diagnostics(process.node)) for process in self.processes]
        said = [f"{node}: {own['message']}" for node, own in nodes if own.get("message", "running") != "running"]
        return "; ".join(filter(None, [f"the drives are {state}" if why else state, why, *said]))

    def send_goal(self, goal: Goal, period: float = 1e-3, timeout: float = CALL_TIMEOUT) -> str:
        """Publishes a goal and waits for the answer; returns the acceptance text. Raises GoalError if refused.

        A goal of drives that are being armed is sent again once they are.
        """
        end = time.monotonic() + timeout
        while True:
            answer: str = self.client.send_goal(goal, round(period * 1e9), timeout)
            if not answer.startswith("refused"):
                return answer
            _, _, code, text = answer.split(" ", 3)
            arming = code.rstrip(":") == NOT_ARMED_CODE and self.client.drive_state != DRIVES_STOPPED
            if not arming or time.monotonic() > end:
                raise GoalError(code.rstrip(":"), text)
            time.sleep(0.01)

    def tick(self) -> int:
        """The next tick of the plant as it last reported; -1 before the first report."""
        return int(self.client.tick)

    def wait_until_tick(self, tick: int, timeout: float = 60.0) -> None:
        """Waits until the plant has come to `tick` (reported every 50 ticks and when it stands still)."""
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
    def has_drives(self) -> bool:
        """Does this session run drives, and laws that give them commands?"""
        executables = {process.executable for process in self.processes}
        return "chain" in executables or set(FOUR) <= executables

    @property
    def plant_node(self) -> str:
        """The node that runs the plant."""
        return "plant_node" if "plant_node" in self.plan.nodes else "chain"

    def diagnostics(self, node: str) -> dict[str, str]:
        """The newest diagnostics of a node as texts, with `level` and `message`; empty before the first."""
        return dict(self.client.diagnostics.get(self._path(node), {}))

    def fresh_diagnostics(self, node: str) -> dict[str, str]:
        """Diagnostics that were made after this call, also when nothing in them has changed since."""
        heard, path = self.client.diagnostics_heard, self._path(node)
        wanted = heard.get(path, 0) + 2  # the next may have been on its way already
        self._wait(lambda: heard.get(path, 0) >= wanted, CALL_TIMEOUT, f"no new diagnostics of {node}")
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
            dead = self._ended()
            if dead:
                lines = self.log(dead[0]).strip().splitlines()
                raise HdError(f"{dead[0]} ended: {lines[-1] if lines else 'see its output'}")
            if time.monotonic() > end:
                raise HdError(f"{what} within {timeout:g} s")
            time.sleep(0.005)

    def _ended(self) -> list[str]:
        """Nodes whose process has ended, which ends the session."""
        return list(self._children.dead())


def log_folder() -> Path:
    """A new folder for the output of node processes."""
    return Path(tempfile.mkdtemp(prefix="hd_logs_"))
