"""The shell of every node: parameters, managed lifecycle, diagnostics, introspection, run id. No arithmetic.

A node says which parameters it has, how to prepare a set of them, what to build on configure and what one turn of its
fast loop is; the shell does the rest. Parameters are declared with meaning, unit and range, and change as a whole or
not at all. States and transitions are those of `rclpy.lifecycle`.
"""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import String

from hd_control import _plane
from hd_control.chain.chain import COMMON, for_joints, shipped_values
from hd_control.core.arrays import FloatArray
from hd_control.core.clock_watch import ClockWatch
from hd_control.core.errors import ConfigError, HdError
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.core.parameters import Change, LiveReach, Parameter, ParameterSet, Shape
from hd_control.core.robot import Robot
from hd_control.nodes.fast_loop import FastLoop, HandsOff, chain_qos, latched_qos
from hd_control.record.cdr import ValuesCodec, new_run_id

# ---- A ParameterSet as ROS parameters --------------------------------------------------------------


STANDARD = ("use_sim_time", "start_type_description_service", "qos_overrides.")
INTEGER_LIMIT = 2**62


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Meaning, unit, source, allowed values and, for a scalar with both bounds, the ROS range."""
    found = ParameterDescriptor(
        name=parameter.name,
        description=f"{parameter.meaning} [{parameter.unit}]" + (f" ({parameter.source})" if parameter.source else ""),
        additional_constraints=f"{parameter.shape.value}; {parameter.allowed}; {parameter.change.value}",
        read_only=parameter.change is Change.FIXED,
        dynamic_typing=True,
    )
    bounded = math.isfinite(parameter.low) and math.isfinite(parameter.high) and not parameter.open_low
    if parameter.shape is Shape.SCALAR and bounded and parameter.kind is float:
        found.floating_point_range = [FloatingPointRange(from_value=parameter.low, to_value=parameter.high)]
    elif parameter.shape is Shape.SCALAR and bounded and parameter.kind is int:
        low, high = max(int(parameter.low), -INTEGER_LIMIT), min(int(parameter.high), INTEGER_LIMIT)
        found.integer_range = [IntegerRange(from_value=low, to_value=high)]
    return found


def plain(parameter: Parameter, value: Any) -> Any:
    """A ROS value as Python lists and numbers; a whole number given for a float becomes a float."""
    if value is not None and not isinstance(value, (str, bytes, bool, int, float)):
        return [plain_number(parameter, item) for item in value]
    return plain_number(parameter, value)


def plain_number(parameter: Parameter, value: Any) -> Any:
    """One element; see `plain`."""
    if parameter.kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


class ParameterService:
    """Declares the parameters of a node and guards their changes.

    `prepare(values)` builds what the laws need from a complete, valid set of values and raises HdError if it cannot;
    `accept(values, prepared)` takes it over. `is_active()` says whether INACTIVE parameters may change.
    """

    def __init__(
        self,
        node: Node,
        parameters: ParameterSet,
        defaults: Mapping[str, Any],
        joints: int,
        is_active: Callable[[], bool],
        prepare: Callable[[dict[str, Any]], Any],
        accept: Callable[[dict[str, Any], Any], None],
    ) -> None:
        self._node, self._set, self._joints = node, parameters, joints
        self._is_active, self._prepare, self._accept = is_active, prepare, accept
        self._pending: tuple[dict[str, Any], Any] | None = None
        self._reach: LiveReach | None = None
        self.changes = self.refusals = 0
        self.last_refusal = ""
        self._declare(defaults)
        node.add_pre_set_parameters_callback(self._to_declared_type)
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take_over)

    @property
    def parameters(self) -> ParameterSet:
        """What is declared."""
        return self._set

    def values(self) -> dict[str, Any]:
        """All values as plain Python objects."""
        return {p.name: plain(p, self._node.get_parameter(p.name).value) for p in self._set.parameters}

    def check(self) -> dict[str, Any]:
        """All values if they are valid, else ConfigError with every problem."""
        values = self.values()
        self._set.check(values, self._joints, self._node.get_name())
        return values

    def anchor(self, robot: Robot) -> None:
        """From now on, while the node is active, values stay within reach of those of this moment."""
        self._reach = LiveReach(self.values(), robot.effort_limit.tolist(), robot.velocity_limit.tolist())

    def _declare(self, defaults: Mapping[str, Any]) -> None:
        given = getattr(self._node, "_parameter_overrides", {})
        unknown = [name for name in given if name not in self._set.names and not name.startswith(STANDARD)]
        problems = self._set.problems(dict.fromkeys(unknown), self._joints)
        problems = [text for text in problems if "unknown parameter" in text]
        for parameter in self._set.parameters:
            value = plain(
                parameter, given[parameter.name].value if parameter.name in given else defaults.get(parameter.name)
            )
            if value is None:
                problems.append(f"{parameter.name}: missing ({parameter.meaning}, {parameter.allowed})")
                continue
            found = parameter.problems(value, self._joints)
            problems.extend(found)
            if not found:
                self._node.declare_parameter(parameter.name, value, descriptor(parameter), ignore_override=True)
        if problems:
            raise ConfigError(FaultCode.PARAM_BAD.line("; ".join(problems), self._node.get_name()))

    def _to_declared_type(self, changes: list[RosParameter]) -> list[RosParameter]:
        return [
            RosParameter(c.name, value=plain(self._set[c.name], c.value))
            if c.name in self._set.names and c.value is not None
            else c
            for c in changes
        ]

    def _judge(self, changes: list[RosParameter]) -> SetParametersResult:
        own = [change for change in changes if change.name in self._set.names]
        if not own:
            return SetParametersResult(successful=True)
        values = self.values()
        before = dict(values)
        values.update({change.name: plain(self._set[change.name], change.value) for change in own})
        refusal = self._set.refusal(before, values, self._joints, self._is_active(), self._reach)
        if not refusal:
            try:
                self._pending = (values, self._prepare(values))
            except HdError as error:
                refusal = FaultCode.PARAM_BAD.line(str(error), self._set.owner)
        if refusal:
            self._pending, self.refusals, self.last_refusal = None, self.refusals + 1, refusal
            return SetParametersResult(successful=False, reason=refusal)
        return SetParametersResult(successful=True)

    def _take_over(self, changes: list[RosParameter]) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            self.changes += 1
            self._accept(*pending)


# ---- The shell -------------------------------------------------------------------------------------


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Shell(LifecycleNode):
    """Base of all nodes. Raises ConfigError at construction if the parameters are not usable."""

    subscriptions_waited = 16

    def __init__(self, name: str, own: ParameterSet) -> None:
        super().__init__(name)
        self.run_id = new_run_id()
        self.group = HandsOff()
        self.loop = FastLoop(self, self.subscriptions_waited)
        self.fault = ""
        self.clock_watch = ClockWatch()
        self.active = False
        self._configured = False
        self.defaults = shipped_values(name)
        self.robot = self.find_robot()
        defaults = for_joints(self.defaults, own, self.robot.joint_names)
        common = tuple(parameter for parameter in COMMON.parameters if parameter.name not in own.names)
        parameters = ParameterSet(name, common + own.parameters, COMMON.rules + own.rules)
        self.service = ParameterService(
            self, parameters, defaults, self.robot.joints, lambda: self.active, self.prepare, self._accept
        )
        self.values = self.service.check()
        self.dt = self.values["period"]
        self.dt_ns = round(self.dt * 1e9)
        self.adopt(self.prepare(self.values))
        self.introspection: Introspection | None = None
        self._diagnostics = self.create_publisher(DiagnosticArray, "diagnostics", chain_qos(10))
        self.create_timer(1.0, self.publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def first_value(self, name: str) -> Any:
        """A parameter's value before it is declared: given at the start, else shipped."""
        given = getattr(self, "_parameter_overrides", {})
        return given[name].value if name in given else self.defaults[name]

    # What a node provides ---------------------------------------------------------------------------------------

    def find_robot(self) -> Robot:
        """The robot whose joints the per-joint parameters are for. Raises RobotError or ConfigError."""
        return Robot.from_file(str(self.first_value("robot")))

    def prepare(self, values: Mapping[str, Any]) -> Any:
        """What the loop needs, from a complete and valid set of values. Raises HdError. Changes nothing."""
        return None

    def adopt(self, prepared: Any) -> None:
        """Takes over what `prepare` built; the loop sees it at its next tick."""

    def build(self) -> Callable[[], None]:
        """Creates topics; returns one turn of the loop."""
        raise NotImplementedError

    def begin(self) -> None:
        """Fresh states before activation."""

    def end(self) -> None:
        """After the last tick of an activation."""

    def dismantle(self) -> None:
        """Destroys what `build` created; the loop is outside."""

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        """Level, one line and named values for diagnostics."""
        return OK, "", {}

    def emergency(self, error: BaseException | None = None) -> None:
        """After an exception in the loop or a callback: bring the outputs to a stop."""

    # Lifecycle --------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.values = self.service.check()
            self.adopt(self.prepare(self.values))
            self.loop.install(self.build())
        except HdError as error:
            self.get_logger().error(f"not configured: {error}")
            return TransitionCallbackReturn.FAILURE
        self._configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.begin()
        except HdError as error:
            self.get_logger().error(f"not activated: {error}")
            return TransitionCallbackReturn.FAILURE
        self.service.anchor(self.robot)
        self.active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        self.end()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.loop.remove()
        self.dismantle()
        self._configured = False
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.active:
            self.on_deactivate(state)
        if self._configured:
            self.on_cleanup(state)
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.report_fault(RuntimeError("a lifecycle transition raised"))
        return self.on_shutdown(state)

    def start_by_itself(self) -> None:
        """Parameter `autostart`: configure and activate without a manager."""
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                return

    def leave(self) -> None:
        """Orderly end, after the loop has stopped."""
        if self.active:
            self.active = False
            self.end()
        if self._configured:
            self.dismantle()

    # Faults, diagnostics, parameters --------------------------------------------------------------------------------

    def report_fault(self, error: BaseException) -> None:
        """Keeps the first fault for the diagnostics and the exit code, and stops the outputs."""
        if not self.fault:
            self.fault = FaultCode.EXCEPTION.line(f"{type(error).__name__}: {error}")
            self.get_logger().error("".join(traceback.format_exception(error)))
        self.emergency(error)

    def publish_diagnostics(self) -> None:
        """Once a second: state, loop statistics, faults."""
        if self.loop.error is not None:
            error, self.loop.error = self.loop.error, None
            self.report_fault(error)
        level, message, values = self.status()
        if self.fault:
            level, message = ERROR, self.fault
        elif not self.active and level == OK:
            message = message or "not active"
        values = {"run_id": self.run_id, "active": self.active, **values, "parameter_changes": self.service.changes}
        values |= {"parameter_refusals": self.service.refusals, "last_refusal": self.service.last_refusal}
        self.clock_watch.look(time.time_ns(), time.monotonic_ns())
        if self.clock_watch.last is not None:
            values |= {"clock_jumps": self.clock_watch.jumps, "last_clock_jump": self.clock_watch.last.text()}
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), message=message or "running", hardware_id=self.robot.name
        )
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _accept(self, values: dict[str, Any], prepared: Any) -> None:
        self.values = values
        self.adopt(prepared)
        if self.introspection is not None:
            self.introspection.on = values["introspection"]


def foreign_report(node: Node, dropped: Mapping[str, int]) -> dict[str, str]:
    """For diagnostics: who may have sent the messages of another run id, by fault. `dropped`: their number by topic.

    The run id of a message shows that there is another source, the graph whether there are two, or one that came back.
    """
    found: dict[str, list[str]] = {}
    for topic, count in dropped.items():
        if count > 0:
            ends = node.get_publishers_info_by_topic(topic)
            names = sorted(f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends)
            fault = Fault(FaultCode.NODE_BACK, -1, count, 0.0, Action.REPORT)
            if len(names) > 1:
                fault = Fault(FaultCode.TWO_PUBLISHERS, -1, len(names), 1.0, Action.REPORT)
            there = f"{'there are' if len(names) > 1 else 'there is'} {', '.join(names) or 'none'}"
            found.setdefault(fault.code.name.lower(), []).append(f"{fault.text()} On {topic} {there}; {count} dropped.")
    return {name: " ".join(texts) for name, texts in found.items()}


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class Introspection:
    """`<node>/introspection/names` (latched, one name a line) and `…/values`, switched by parameter `introspection`."""

    def __init__(self, node: Shell, names: list[str]) -> None:
        from std_msgs.msg import Float64MultiArray

        base = f"{node.get_name()}/introspection"
        self._names = node.create_publisher(String, f"{base}/names", latched_qos())
        self._names.publish(String(data="\n".join(names)))
        self._values = node.create_publisher(Float64MultiArray, f"{base}/values", chain_qos(100))
        self._codec = ValuesCodec(len(names))
        self._outbox: _plane.Outbox | None = None
        self.count = len(names)
        self._on = bool(node.values["introspection"])

    @property
    def on(self) -> bool:
        """Are values published?"""
        return self._on

    @on.setter
    def on(self, on: bool) -> None:
        self._on = on
        if self._outbox is not None:
            self._outbox.switch(on)

    def outbox(self, plane: _plane.Loop, numbers: Sequence[FloatArray]) -> _plane.Outbox:
        """The rows in a loop: the numbers, `count` in all, are taken from where they are, one array after the other."""
        runs, at = [], self._codec.places["data"][0]
        for part in numbers:
            runs.append((at, part))
            at += 8 * part.size
        self._outbox = plane.outbox(self._values.handle, self._codec.encode(), _plane.NO_STAMP, runs)
        self._outbox.switch(self._on)
        return self._outbox

    def destroy(self, node: Shell) -> None:
        """Removes both topics; the loop is closed."""
        node.destroy_publisher(self._names)
        node.destroy_publisher(self._values)
