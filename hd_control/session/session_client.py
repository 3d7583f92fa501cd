"""The ROS side of a session, in a context of its own: lifecycle, parameters, goals, progress, diagnostics, tracking."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from hd_control.core import topics
from hd_control.core.errors import HdError
from hd_control.laws.trajectory import Goal
from hd_control.nodes.convert import message_from_goal, stamp_ns
from hd_control.nodes.fast_loop import chain_qos, latched_qos
from hd_control.nodes.process import prepare_environment

TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}
_NUMBERS = itertools.count(1)


class SessionClient:
    """Service clients and subscriptions, served by a thread of their own."""

    def __init__(self, namespace: str, domain: int | None) -> None:
        prepare_environment()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        name = f"session_{next(_NUMBERS)}"
        self.node = rclpy.create_node(
            name, context=self._context, namespace=f"/{namespace.strip('/')}", enable_rosout=False
        )
        self.tick = self.recorded = -1
        self.drive_state = ""
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.diagnostics_heard: dict[str, int] = {}
        self.answers: list[str] = []
        self._clients: dict[tuple[Any, str], Any] = {}
        for plant in ("plant_node", "chain"):
            self.node.create_subscription(UInt64, f"{plant}/progress", self._progress, latched_qos())
        self.node.create_subscription(UInt64, topics.PROGRESS, self._recorded, latched_qos())
        self.node.create_subscription(String, topics.DRIVES, self._drives, latched_qos())
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._diagnose, chain_qos(100))
        for motion in ("motion_node", "chain"):
            self.node.create_subscription(String, f"{motion}/goal_status", self._answer, latched_qos())
        self._goals = self.node.create_publisher(JointTrajectory, "joint_trajectory", chain_qos(10))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, name="session", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and leaves the ROS network."""
        self._closing = True
        self._executor.wake()
        self._thread.join(2.0)
        self._executor.shutdown(0.2)
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def ready(self, path: str) -> bool:
        """True once the node's lifecycle and parameter services are there."""
        services = ((ChangeState, "change_state"), (SetParametersAtomically, "set_parameters_atomically"))
        return all(self._client(kind, f"{path}/{name}").service_is_ready() for kind, name in services)

    def transition(self, paths: Sequence[str], name: str, timeout: float) -> None:
        """One lifecycle transition of several nodes at once. Raises HdError if one refuses."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
        futures = {path: self._client(ChangeState, f"{path}/change_state").call_async(request) for path in paths}
        for path, future in futures.items():
            if not self._result(future, timeout, f"{path} {name}").success:
                raise HdError(f"{path} refused to {name}; its log says why")

    def set_parameters(self, path: str, values: Mapping[str, Any], timeout: float) -> str:
        """Atomic change; returns the reason of a refusal."""
        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(key, value=value).to_parameter_msg() for key, value in values.items()]
        answer = self._call(SetParametersAtomically, f"{path}/set_parameters_atomically", request, timeout)
        return "" if answer.result.successful else str(answer.result.reason)

    def get_parameters(self, path: str, names: list[str] | None, timeout: float) -> dict[str, Any]:
        """Values by name, all if `names` is None."""
        if names is None:
            listed = self._call(ListParameters, f"{path}/list_parameters", ListParameters.Request(), timeout)
            names = sorted(listed.result.names)
        answer = self._call(GetParameters, f"{path}/get_parameters", GetParameters.Request(names=names), timeout)
        return {
            name: _plain(parameter_value_to_python(value)) for name, value in zip(names, answer.values, strict=True)
        }

    def reset(self, path: str, timeout: float) -> str:
        """`~/reset`; returns the reasons of a refusal."""
        answer = self._call(Trigger, f"{path}/reset", Trigger.Request(), timeout)
        return "" if answer.success else str(answer.message)

    def send_goal(self, goal: Goal, dt_ns: int, timeout: float) -> str:
        """Publishes a goal; returns the motion node's answer to it."""
        self._until(lambda: self._goals.get_subscription_count() > 0, timeout, "nobody takes goals")
        named = goal if goal.identifier else replace(goal, identifier=f"goal_{time.monotonic_ns()}")
        seen = len(self.answers)
        self._goals.publish(message_from_goal(named, dt_ns))

        def answered() -> list[str]:
            return [text for text in self.answers[seen:] if text.split(" ")[1:2] == [named.identifier]]

        self._until(lambda: bool(answered()), timeout, f"no answer to goal {named.identifier}")
        return answered()[0]

    def _spin(self) -> None:
        while not self._closing:
            self._executor.spin_once(timeout_sec=0.5)

    def _client(self, kind: Any, name: str) -> Any:
        if (kind, name) not in self._clients:
            self._clients[kind, name] = self.node.create_client(kind, name)
        return self._clients[kind, name]

    def _call(self, kind: Any, name: str, request: Any, timeout: float) -> Any:
        client = self._client(kind, name)
        self._until(client.service_is_ready, timeout, f"{name} is not there")
        return self._result(client.call_async(request), timeout, name)

    def _result(self, future: Any, timeout: float, what: str) -> Any:
        self._until(future.done, timeout, f"{what}: no answer")
        return future.result()

    def _until(self, condition: Any, timeout: float, what: str) -> None:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise HdError(f"{what} within {timeout:g} s")
            time.sleep(0.002)

    def _progress(self, message: UInt64) -> None:
        self.tick = message.data

    def _drives(self, message: String) -> None:
        self.drive_state = message.data

    def _recorded(self, message: UInt64) -> None:
        self.recorded = message.data

    def _answer(self, message: String) -> None:
        self.answers.append(message.data)

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.diagnostics[status.name] = values | {"level": str(status.level[0]), "message": status.message}
            self.diagnostics_heard[status.name] = self.diagnostics_heard.get(status.name, 0) + 1


def _plain(value: Any) -> Any:
    return value if isinstance(value, (str, bool, int, float, bytes)) or value is None else list(value)


# ---- The tracking error: reference against measured joint position, RMS over seconds of ticks ------


WORSE = 1.05
"""A correction is withdrawn above this ratio of the errors after and before."""
SLOWEST = 20.0
"""Wall seconds allowed for one second of ticks."""


QUEUE = 1000
"""Messages that may wait to be heard: what is measured now may be so many ticks old where lock-step runs fast."""


class TrackingWatch:
    """Listens to `joint_reference` and `joint_states`; the node must be spun by another thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._positions: dict[str, dict[int, JointState]] = {topics.REFERENCE: {}, topics.JOINT_STATES: {}}

    def _keeper(self, kept: dict[int, JointState]):  # type: ignore[no-untyped-def]
        def keep(message: JointState) -> None:
            kept[stamp_ns(message.header.stamp)] = message

        return keep

    def measure(self, seconds: float) -> dict[str, float]:
        """RMS by joint over the next `seconds` of ticks, rad. Raises HdError if the topics do not carry them."""
        for kept in self._positions.values():
            kept.clear()
        with self._listening():
            end = time.monotonic() + 5.0 + SLOWEST * seconds
            while time.monotonic() < end:
                both = self._both()
                if len(both) > 1 and both[-1] - both[0] >= seconds * 1e9:
                    return self._rms(both)
                time.sleep(0.05)
        raise HdError(f"joint_reference and joint_states did not carry {seconds:g} s of ticks; is the robot active?")

    @contextmanager
    def _listening(self) -> Iterator[None]:
        """Only while something is measured: lock-step floods a listener, and answers of services would wait."""
        node, made = self._node, []
        try:
            for topic, kept in self._positions.items():
                made.append(node.create_subscription(JointState, topic, self._keeper(kept), chain_qos(QUEUE)))
            yield
        finally:
            for subscription in made:
                node.destroy_subscription(subscription)

    def settle(self, seconds: float) -> None:
        """Lets `seconds` of ticks pass, and as many as were on their way when this was called."""
        _, waiting = self.measure(0.01), list(self._both())
        period = (waiting[-1] - waiting[0]) / (len(waiting) - 1) * 1e-9
        self.measure(seconds + QUEUE * period)

    def _both(self) -> list[int]:
        reference, states = (list(self._positions[name]) for name in (topics.REFERENCE, topics.JOINT_STATES))
        return sorted(set(reference) & set(states))

    def _rms(self, stamps: Iterable[int]) -> dict[str, float]:
        errors, names = [], []
        for stamp in stamps:
            wanted, measured = (self._positions[name][stamp] for name in (topics.REFERENCE, topics.JOINT_STATES))
            names = list(wanted.name)
            found = dict(zip(measured.name, measured.position, strict=True))
            errors.append([w - found[name] for name, w in zip(names, wanted.position, strict=True)])
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        return dict(zip(names, rms.tolist(), strict=True))


def growth(before: Mapping[str, float], after: Mapping[str, float], joints: Iterable[str]) -> float:
    """Geometric mean over the joints of the errors after over before; 1 without joints."""
    ratios = [after[joint] / before[joint] for joint in joints if before.get(joint, 0.0) > 0.0 and joint in after]
    return float(np.exp(np.mean(np.log(np.maximum(ratios, 1e-12))))) if ratios else 1.0
