"""Formulas and tables of a model file: their values, and one clear line with the column for what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drive.drive_cases import CONTEXT, moving

from hd_control.core.errors import ConfigError
from hd_control.drive.effect import GAUGE, LINK, MOTOR, Effect
from hd_control.drive.expression import Expression, Table, check_names, parse_formula
from hd_control.drive.model_file import parse_model

STATES = moving(300)
FORMULAS = {
    "2 + 3 * 4 ** 2 / 8 - -1": np.full(300, 9.0),
    "-2 ** 2": np.full(300, -4.0),
    "sin(joint_position) * cos(2 * joint_position)": np.sin(STATES.joint_position) * np.cos(2 * STATES.joint_position),
    "direction * abs(joint_torque)": STATES.motor_direction * np.abs(STATES.joint_torque),
    "sign(motor_velocity) * sqrt(abs(motor_velocity))": np.sign(STATES.motor_velocity)
    * np.sqrt(np.abs(STATES.motor_velocity)),
    "tanh(motor_torque / 50) * exp(-time)": np.tanh(STATES.motor_torque / 50.0) * np.exp(-STATES.time),
    "min(temperature, 30) - max(temperature, 28)": np.minimum(STATES.temperature, 30.0)
    - np.maximum(STATES.temperature, 28.0),
    "sin(2 * motor_shaft_position) - gear_ratio * pi": np.sin(240.0 * STATES.motor_position) - 120.0 * np.pi,
}


def column(expression: Expression, values: dict[str, float] | None = None, channel: str = "link_torque") -> np.ndarray:
    """What the expression adds to a channel, (n,)."""
    effect = expression.effect()
    shape, coefficients = effect.split(values or {}, CONTEXT)
    return effect.columns(STATES, shape)[channel] @ coefficients


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_formula_has_the_value_of_its_words(formula: str) -> None:
    np.testing.assert_allclose(column(Expression("mine", {"link_torque": 1.0}, formula)), FORMULAS[formula], rtol=1e-13)


def test_parameters_come_in_the_order_of_the_formula_and_go_round() -> None:
    expression = Expression("mine", {"motor_torque": 1.0}, "b * motor_velocity + a", units={"b": "N m s", "a": "N m"})
    effect = expression.effect()
    assert issubclass(effect, Effect) and sorted(p.name for p in effect.parameters) == ["a", "b"]
    assert {p.name: p.unit for p in effect.parameters} == {"a": "N m", "b": "N m s"}
    shape, coefficients = effect.split({"a": 2.0, "b": 3.0}, CONTEXT)
    assert effect.join(shape, coefficients, CONTEXT) == {"a": 2.0, "b": 3.0}
    moved = column(expression, {"a": 2.0, "b": 3.0}, "motor_torque")
    np.testing.assert_allclose(moved, 3.0 * STATES.motor_velocity + 2.0)


@pytest.mark.parametrize(
    ("formula", "at", "words"),
    [
        ("c * foo(joint_position)", 5, "function 'foo' is not one of sin"),
        ("1 + c.real", 5, "Attribute is not allowed"),
        ("1 + c ** d", 5, "a power must be a number up to 8"),
        ("sin(c", 4, "not an arithmetic expression"),
        ("1 +  2 +\n sin", 9, "function 'sin' without argument"),
        ("1 + min(c)", 5, "min takes 2 arguments"),
        ("c * 'x'", 5, "'x' is not a number"),
        ("1 < 2", 1, "Compare is not allowed; use numbers"),
        ("1 + ~c", 5, "operator Invert is not known"),
    ],
)
def test_a_wrong_formula_is_one_line_with_its_column(formula: str, at: int, words: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_formula(formula)
    assert f"column {at}: " in str(error.value) and words in str(error.value) and "\n" not in str(error.value)


def test_a_misspelt_signal_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"column 9: 'joint_positon' is no signal .* did you mean 'joint_position'"):
        check_names("c * sin(joint_positon) + d", ["c"])
    text = """schema: hd.model/1
joints:
  a:
    gear_ratio: 100
    effects:
      - expression:
          name: mine
          channel: link_torque
          formula: "c * sin(joint_position)"
"""
    with pytest.raises(ConfigError, match=r"m.yaml: a: expression: formula \(line 9\): .*column 1: 'c' is no signal"):
        parse_model(text, "m.yaml")


def test_a_name_of_the_library_is_taken() -> None:
    with pytest.raises(ConfigError, match="the library has an effect of this name"):
        Expression("payload", {"link_torque": 1.0}, "1").effect()


def test_a_formula_without_value_is_named_and_gaps_are_gaps() -> None:
    expression = Expression("mine", {"link_torque": 1.0}, "1 / temperature")
    cold = replace(STATES, temperature=np.where(STATES.time == STATES.time[200], 0.0, 20.0))
    with pytest.raises(ConfigError, match=r"expression mine: '1 / temperature' is inf at 0\.200 s"):
        expression.effect().columns(cold, {})
    gap = replace(STATES, temperature=np.where(STATES.time == STATES.time[200], np.nan, 20.0))
    assert np.isnan(expression.effect().columns(gap, {})["link_torque"][:, 0]).sum() == 1
    # in a prediction a run that went astray must not stop the others
    moved, _ = expression.effect().advance(cold, {}, np.zeros((0, 300)))
    assert np.isinf(moved["link_torque"]).sum() == 1


@pytest.mark.parametrize(
    ("times", "factor"),
    [
        ("none", 1.0),
        ("direction", STATES.motor_direction),
        ("velocity", STATES.motor_velocity),
        ("torque", STATES.joint_torque),
        ("temperature", STATES.temperature),
    ],
)
def test_a_table_is_piecewise_linear_and_zero_outside(times: str, factor: np.ndarray | float) -> None:
    knots, values = (0.08, 0.12, 0.2, 0.25), (1.0, -2.0, 4.0, 3.0)
    found = column(
        Expression("mine", {"link_torque": 1.0}, table=Table("joint_position", knots, times)),
        {f"value_{i + 1}": value for i, value in enumerate(values)},
    )
    q = STATES.joint_position
    expected = np.where((q >= 0.08) & (q <= 0.25), np.interp(q, knots, values), 0.0) * factor
    assert (q < 0.08).any() and (q > 0.25).any()
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (Table("joint_angle", (0.0, 1.0)), "signal 'joint_angle' is not one of"),
        (Table("time", (0.0, 1.0, 1.0)), "two or more increasing numbers"),
        (Table("time", (0.0,)), "two or more increasing numbers"),
        (Table("time", (0.0, 1.0), "twice"), "times 'twice' is not none, direction, velocity, torque or a signal"),
    ],
)
def test_a_wrong_table_is_named(table: Table, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Expression("mine", {"link_torque": 1.0}, table=table).effect()


def test_opposite_signs_on_rotor_and_link_are_a_reading_of_the_gauge() -> None:
    both = Expression("drift", {MOTOR: -1.0, LINK: 1.0}, "c * time", None, {}).effect()
    alone = Expression("drag", {MOTOR: 1.0}, "c * time", None, {}).effect()
    assert (both.reads, alone.reads) == (GAUGE, "")
