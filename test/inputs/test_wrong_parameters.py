"""Parameters (goal G14): what is right is taken, what is wrong is refused as a whole with its name, nothing changes."""

from __future__ import annotations

import copy
import math
import random
from typing import Any

import pytest

from hd_control.chain.chain import shipped_values
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Parameter, ParameterSet, Shape
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


def right_value(parameter: Parameter, value: Any, rng: random.Random) -> Any:
    """Another value that the declaration allows, so near the shipped one that the rules between values still hold."""

    def near(number: Any) -> Any:
        if parameter.kind is not float:
            return number
        moved = number * (1.0 + rng.uniform(-1e-3, 1e-3))
        return min(max(moved, parameter.low), parameter.high)

    return [near(each) for each in value] if isinstance(value, list) else near(value)


def judge_wrong_sets(node: str, seed: Any, cases: int) -> None:
    """Sets with one wrong value: each refused as a whole, the value named, nothing changed."""
    parameters, good = values_of(node)
    assert parameters.problems(good, JOINTS) == []
    rng = random.Random(seed)
    for number in range(cases):
        parameter = rng.choice(parameters.parameters)
        values = {**good, parameter.name: wrong_value(parameter, good[parameter.name], rng)}
        before = copy.deepcopy(values)
        with pytest.raises(ConfigError) as refused:
            parameters.check(values, JOINTS)
        assert parameter.name in str(refused.value), f"{number}: {parameter.name} = {values[parameter.name]!r:.100}"
        assert repr(values) == repr(before)


def judge_right_sets(node: str, seed: Any, cases: int) -> None:
    """Sets of right values: each taken. Bounds that are equal to what they bound stay as they are."""
    parameters, good = values_of(node)
    rng = random.Random(seed)
    free = [p for p in parameters.parameters if not p.name.endswith(("_low", "_high", "_low_factor", "_high_factor"))]
    for _ in range(cases):
        changed = {p.name: right_value(p, good[p.name], rng) for p in rng.sample(free, min(4, len(free)))}
        assert parameters.problems({**good, **changed}, JOINTS) == []


@pytest.mark.parametrize("node", LAWS)
def test_one_wrong_value_refuses_the_whole_set_and_is_named(node):
    judge_wrong_sets(node, node, CASES)


@pytest.mark.parametrize("node", LAWS)
def test_right_values_are_taken(node):
    judge_right_sets(node, node, 50)


@pytest.mark.parametrize("node", LAWS)
def test_missing_and_unknown_names_are_refused(node):
    parameters, good = values_of(node)
    for name in parameters.names:
        rest = {key: value for key, value in good.items() if key != name}
        assert any(text.startswith(f"{name}: missing") for text in parameters.problems(rest, JOINTS))
        assert any("did you mean" in text for text in parameters.problems({**good, name + "s": 1.0}, JOINTS))
