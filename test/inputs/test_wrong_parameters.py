"""Parameters (goal G14): what is right is taken, what is wrong is refused as a whole with its name, nothing changes."""

from __future__ import annotations

import copy
import math
import random
from typing import Any

import pytest

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Parameter, ParameterSet, Shape
from hd_control.stages.node_parameters import shipped_values
from hd_sim.runner import LAWS

JOINTS = 7
CASES = 150
NOT_NUMBERS: list[Any] = ["1.0", None, True, [], {}, float("nan"), math.inf, -math.inf, b"1", 10**400]


def values_of(node: str) -> tuple[ParameterSet, dict[str, Any]]:
    """The parameters of a node and the shipped values."""
    parameters: ParameterSet = LAWS[node].PARAMETERS
    return parameters, {name: value for name, value in shipped_values(node).items() if name in parameters.names}


def wrong_element(parameter: Parameter, rng: random.Random) -> Any:
    """A value that one element of the parameter must not have, by its declaration alone."""
    if parameter.kind is bool:
        return rng.choice(["true", 1, 0.0, None, []])
    if parameter.kind is str:
        return rng.choice([1, None, True, *(["no such choice"] if parameter.choices else [])])
    choices = list(NOT_NUMBERS)
    if parameter.kind is int:
        choices.append(0.5)
    if math.isfinite(parameter.low):
        choices += [parameter.low - 1.0, parameter.low - 1e-9 * max(1.0, abs(parameter.low))]
        choices += [parameter.low] if parameter.open_low else []
    if math.isfinite(parameter.high):
        choices += [parameter.high + 1.0, parameter.high * 1.000001 + 1e-9]
    return rng.choice(choices)


def wrong_value(parameter: Parameter, value: Any, rng: random.Random) -> Any:
    """A wrong value of the whole parameter: one element, the length, or the kind."""
    if parameter.shape is Shape.SCALAR:
        return rng.choice([wrong_element(parameter, rng), [value], {"value": value}])
    if parameter.shape is Shape.PER_JOINT and rng.random() < 0.3:
        return rng.choice([value[:-1], [*value, value[0]], [], value[0], dict(enumerate(value))])
    changed = list(value) or [0]
    changed[rng.randrange(len(changed))] = wrong_element(parameter, rng)
    return changed


@pytest.mark.parametrize("node", LAWS)
def test_one_wrong_value_refuses_the_whole_set_and_is_named(node):
    parameters, good = values_of(node)
    assert parameters.problems(good, JOINTS) == []
    rng = random.Random(node)
    for number in range(CASES):
        parameter = rng.choice(parameters.parameters)
        values = {**good, parameter.name: wrong_value(parameter, good[parameter.name], rng)}
        before = copy.deepcopy(values)
        with pytest.raises(ConfigError) as refused:
            parameters.check(values, JOINTS)
        assert parameter.name in str(refused.value), f"{number}: {parameter.name} = {values[parameter.name]!r:.100}"
        assert repr(values) == repr(before)


@pytest.mark.parametrize("node", LAWS)
def test_missing_and_unknown_names_are_refused(node):
    parameters, good = values_of(node)
    for name in parameters.names:
        rest = {key: value for key, value in good.items() if key != name}
        assert any(text.startswith(f"{name}: missing") for text in parameters.problems(rest, JOINTS))
        assert any("did you mean" in text for text in parameters.problems({**good, name + "s": 1.0}, JOINTS))
