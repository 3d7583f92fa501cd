"""A ParameterSet as ROS parameters: declared with meaning, unit and range, changed as a whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from hd_control.core.errors import ConfigError, HdError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape

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


class ParameterDesk:
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
            raise ConfigError(f"{self._node.get_name()}: " + "; ".join(problems))

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
        changed = [name for name in values if values[name] != before[name]]
        problems = self._set.problems(values, self._joints)
        if not problems and self._is_active():
            still = [name for name in changed if self._set[name].change is not Change.HOT]
            problems = [f"{name}: {before[name]!r} stays, a change needs INACTIVE" for name in still]
        if not problems:
            try:
                self._pending = (values, self._prepare(values))
            except HdError as error:
                problems = [str(error)]
        if problems:
            self._pending, self.refusals, self.last_refusal = None, self.refusals + 1, "; ".join(problems)
            return SetParametersResult(successful=False, reason=self.last_refusal)
        return SetParametersResult(successful=True)

    def _take_over(self, changes: list[RosParameter]) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            self.changes += 1
            self._accept(*pending)
