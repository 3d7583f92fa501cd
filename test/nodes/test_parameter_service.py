"""Live parameters (F20, F21): a change is judged as a whole, before it has any effect; refusals change nothing."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.parameter import Parameter as RosParameter

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.nodes.shell import ParameterService

SET = ParameterSet(
    "node",
    (
        Parameter("stiffness", "k_f", "N m/rad", low=0.0, open_low=True, change=Change.HOT),
        Parameter("rate", "lambda", "1/(N m s)", low=0.0, change=Change.HOT),
        Parameter("gain", "a gain", shape=Shape.PER_JOINT, low=0.0, change=Change.HOT, live=(10.0, 0.0)),
        Parameter("law", "a law", kind=str, choices=("a", "b")),
    ),
    (lambda v: [] if v["stiffness"] * v["rate"] < 1.0 else ["loop gain >= 1"],),
)
SHIPPED = {"stiffness": 100.0, "rate": 0.005, "gain": [1.0, 2.0], "law": "a"}


class FakeNode:
    """As much of a node as the service uses."""

    def __init__(self):
        self._parameter_overrides, self.stored, self.callbacks = {}, {}, {}

    def get_name(self):
        return "fake"

    def get_parameter(self, name):
        return SimpleNamespace(value=self.stored[name])

    def declare_parameter(self, name, value, descriptor, ignore_override):
        self.stored[name] = value

    def __getattr__(self, name):
        if name.startswith("add_"):
            return lambda function: self.callbacks.__setitem__(name, function)
        raise AttributeError(name)

    def set(self, **values):
        """What rclpy does with a set of changes: to the declared types, judged, then stored and announced."""
        changes = [RosParameter(name, value=value) for name, value in values.items()]
        changes = self.callbacks["add_pre_set_parameters_callback"](changes)
        result = self.callbacks["add_on_set_parameters_callback"](changes)
        if result.successful:
            self.stored.update({change.name: change.value for change in changes})
            self.callbacks["add_post_set_parameters_callback"](changes)
        return result


def service(active=True, prepare=lambda values: values):
    node, taken = FakeNode(), []
    made = ParameterService(node, SET, SHIPPED, 2, lambda: active, prepare, lambda values, ready: taken.append(values))
    return node, made, taken


def test_f20_values_that_are_right_only_together_are_taken_together():
    node, made, taken = service()
    assert node.set(stiffness=1000.0, rate=0.0005).successful
    assert (taken[-1]["stiffness"], taken[-1]["rate"], made.changes) == (1000.0, 0.0005, 1)
    assert not node.set(stiffness=1000.0, rate=0.005).successful, "each alone would be right with the old other one"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rate": 0.02}, "loop gain"),
        ({"stiffness": -1.0, "rate": 0.001}, "stiffness: -1"),
        ({"gain": [1.0]}, "1 values, expected 2"),
        ({"gain": [1.0, float("nan")]}, r"gain\[1\]"),
        ({"gain": [3.0, 4.0], "rate": float("inf")}, "rate"),
    ],
)
def test_f20_a_refusal_changes_nothing_and_is_counted(change, says):
    node, made, taken = service()
    before = dict(node.stored)
    result = node.set(**change)
    assert not result.successful and taken == [] and node.stored == before == made.values()
    assert re.search(says, result.reason) and made.last_refusal == result.reason
    assert result.reason.startswith("HD-F20 param_bad node: ")
    assert (made.changes, made.refusals) == (0, 1)


def test_f21_a_value_that_needs_inactive_is_refused_while_active():
    node, made, taken = service(active=True)
    result = node.set(law="b", gain=[5.0, 6.0])
    assert not result.successful
    assert result.reason == "HD-F21 param_moving node: law: 'a' stays, a change needs INACTIVE"
    assert taken == [] and node.stored["gain"] == [1.0, 2.0]
    node, made, taken = service(active=False)
    assert node.set(law="b").successful and taken[-1]["law"] == "b"


def test_f21_while_active_values_stay_within_reach_of_those_at_the_activation():
    """Several changes go no further than one; a new activation counts from where they are."""
    node, made, taken = service()
    robot = SimpleNamespace(effort_limit=np.array([9.0, 9.0]), velocity_limit=np.array([1.0, 1.0]))
    assert node.set(gain=[1.0, 1e12]).successful, "before the first activation"
    assert node.set(gain=[1.0, 2.0]).successful
    made.anchor(robot)
    assert not node.set(gain=[1.0, 1e12]).successful and not node.set(gain=[1.0, 20.1]).successful
    assert node.set(gain=[1.0, 15.0]).successful and not node.set(gain=[1.0, 45.0]).successful
    made.anchor(robot)
    assert node.set(gain=[1.0, 45.0]).successful and made.refusals == 3
    assert made.last_refusal == "HD-F21 param_moving node: gain[1]: 45 is outside [0.2, 20] - while active"


def test_f20_what_the_law_cannot_prepare_is_refused():
    def prepare(values):
        raise ConfigError("the law says no")

    node, made, taken = service(prepare=prepare)
    assert node.set(rate=0.001).reason == "HD-F20 param_bad node: the law says no" and taken == []
