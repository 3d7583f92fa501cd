"""Effects that a model file writes down itself: a formula in named signals and parameters, or a table.

    expression: {name: cable, channel: link_torque, formula: "c * sin(joint_position)", parameters: {c: 3.0}}
    expression: {name: bump, channel: motor_torque, table: {signal: joint_position, knots: [0, 1], values: [0, 2]}}

A formula is read into a tree of whitelisted nodes; nothing is ever run as code. A table is piecewise linear inside its
range and zero outside. Both are the column of their channel: torque that resists (N m), or angle that is added (rad).
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_control.drive.effect import (
    CHANNELS,
    UNITS,
    Columns,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    FloatArray,
    Shape,
)

SIGNALS = (
    "time motor_position motor_velocity motor_acceleration motor_direction motor_shaft_position joint_position "
    "joint_velocity joint_acceleration gauge_torque joint_torque joint_torque_rate motor_torque temperature"
).split()
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "tanh": np.tanh, "atan2": np.arctan2, "exp": np.exp, "log": np.log,
    "sqrt": np.sqrt, "abs": np.abs, "sign": np.sign, "min": np.minimum, "max": np.maximum,
}  # fmt: skip
ARGUMENTS = {"atan2": 2, "min": 2, "max": 2}
CONSTANTS = {"pi": float(np.pi)}
MAX_LENGTH, MAX_NODES, MAX_POWER = 500, 200, 8.0
_OPERATIONS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Piecewise-linear over one signal at `knots` (increasing), times another (`times`: "none", "sign" of the motor
    velocity, or a signal); zero outside the knots. The values at the knots are the parameters `value_1`, ..."""

    signal: str
    knots: tuple[float, ...]
    times: str = "none"


@dataclass(frozen=True)
class Expression:
    """One expression effect. `channels`: channel -> factor; either `formula` or `table`; `units` of its parameters."""

    name: str
    channels: Mapping[str, float]
    formula: str = ""
    table: Table | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters of the formula in order of appearance, or one value for each knot."""
        if self.table is not None:
            return tuple(f"value_{i + 1}" for i in range(len(self.table.knots)))
        names = [node.id for node in ast.walk(parse_formula(self.formula)) if isinstance(node, ast.Name)]
        taken = {*SIGNALS, *FUNCTIONS, *CONSTANTS, "gear_ratio"}
        return tuple(dict.fromkeys(name for name in names if name not in taken))

    @property
    def unit(self) -> str:
        """Unit of a parameter that does not name one."""
        plain = self.table is not None and self.table.times in ("none", "sign")
        return UNITS.get(next(iter(self.channels), ""), "") if plain else ""

    def effect(self) -> type[Effect]:
        """The effect class of this expression. Raises ConfigError if it cannot be used."""
        key = (self.name, tuple(self.channels.items()), self.formula, self.table, tuple(self.units.items()))
        return _effect_class(*key)


def check_expression(expression: Expression) -> list[str]:
    """What is wrong with an expression, one clause each."""
    problems = [
        f"channel {name!r} is not one of {', '.join(CHANNELS)}" for name in expression.channels if name not in UNITS
    ]
    if not expression.channels:
        problems.append("it names no channel")
    if (expression.table is None) == (not expression.formula):
        problems.append("give either a formula or a table")
    elif expression.table is not None:
        problems += _table_problems(expression.table)
    else:
        try:
            parse_formula(expression.formula)
        except ConfigError as error:
            problems.append(str(error))
    return problems


def parse_formula(text: str) -> ast.expr:
    """The syntax tree of a formula with whitelisted nodes only. Raises ConfigError naming what does not fit."""
    if len(text) > MAX_LENGTH:
        raise ConfigError(f"formula longer than {MAX_LENGTH} characters")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ConfigError(f"formula {text!r} is not an arithmetic expression") from None
    nodes = list(ast.walk(tree))
    if len(nodes) > MAX_NODES:
        raise ConfigError(f"formula with more than {MAX_NODES} parts")
    called = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    for node in nodes:
        if problem := _node_problem(node, id(node) in called):
            raise ConfigError(f"formula {text!r}: {problem}")
    return tree


def _node_problem(node: ast.AST, called: bool) -> str:
    """Why a node is not allowed; empty if it is."""
    if isinstance(node, (ast.operator, ast.unaryop, ast.expr_context)):
        fine = isinstance(node, (*_OPERATIONS, ast.USub, ast.UAdd, ast.Load))
        return "" if fine else f"operator {type(node).__name__} is not known"
    if isinstance(node, ast.Constant):
        number = not isinstance(node.value, bool) and isinstance(node.value, (int, float)) and abs(node.value) < 1e30
        return "" if number else f"{node.value!r} is not a number"
    if isinstance(node, ast.Name):
        if called:
            return "" if node.id in FUNCTIONS else f"function {node.id!r} is not one of {', '.join(FUNCTIONS)}"
        return f"function {node.id!r} without argument" if node.id in FUNCTIONS else ""
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.keywords:
            return "only plain functions can be called"
        count = ARGUMENTS.get(node.func.id, 1)
        return "" if len(node.args) == count else f"{node.func.id} takes {count} argument{'s' if count > 1 else ''}"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        fine = isinstance(node.right, ast.Constant) and isinstance(node.right.value, (int, float))
        return "" if fine and abs(node.right.value) <= MAX_POWER else f"a power must be a number up to {MAX_POWER:g}"  # type: ignore[attr-defined]  # checked in `fine`
    return "" if isinstance(node, (ast.BinOp, ast.UnaryOp)) else f"{type(node).__name__} is not allowed"


def evaluate_formula(tree: ast.expr, values: Mapping[str, Any]) -> Any:
    """The value of a checked tree with signals, parameters and constants by name; numbers or arrays."""
    if isinstance(tree, ast.Constant):
        return float(tree.value)  # type: ignore[arg-type]  # a number, checked by parse_formula
    if isinstance(tree, ast.Name):
        return values[tree.id]
    if isinstance(tree, ast.UnaryOp):
        inner = evaluate_formula(tree.operand, values)
        return -inner if isinstance(tree.op, ast.USub) else inner
    if isinstance(tree, ast.BinOp):
        return _OPERATIONS[type(tree.op)](evaluate_formula(tree.left, values), evaluate_formula(tree.right, values))
    assert isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name)
    return FUNCTIONS[tree.func.id](*(evaluate_formula(argument, values) for argument in tree.args))


def table_columns(table: Table, states: DriveStates) -> FloatArray:
    """Hat functions of the knots (n, k), times the other signal; zero outside the range."""
    x = np.asarray(getattr(states, table.signal), dtype=float)
    knots = np.array(table.knots)
    right = np.clip(np.searchsorted(knots, x, side="right"), 1, knots.size - 1)
    share = (x - knots[right - 1]) / (knots[right] - knots[right - 1])
    inside = (x >= knots[0]) & (x <= knots[-1])
    hats = np.zeros((x.size, knots.size))
    rows = np.arange(x.size)
    hats[rows, right - 1] = np.where(inside, 1.0 - share, 0.0)
    hats[rows, right] = np.where(inside, share, 0.0)
    if table.times != "none":
        hats *= getattr(states, "motor_direction" if table.times == "sign" else table.times)[:, None]
    return hats


def _table_problems(table: Table) -> list[str]:
    problems = [] if table.signal in SIGNALS else [f"signal {table.signal!r} is not one of {', '.join(SIGNALS)}"]
    if table.times not in ("none", "sign", *SIGNALS):
        problems.append(f"times {table.times!r} is not none, sign or a signal")
    if len(table.knots) < 2 or any(b <= a for a, b in zip(table.knots, table.knots[1:], strict=False)):
        problems.append("knots must be two or more increasing numbers")
    return problems


@lru_cache(maxsize=256)
def _effect_class(
    name: str,
    channels: tuple[tuple[str, float], ...],
    formula: str,
    table: Table | None,
    units: tuple[tuple[str, str], ...],
) -> type[Effect]:
    expression = Expression(name, dict(channels), formula, table, dict(units))
    if problems := check_expression(expression):
        raise ConfigError(f"expression {name}: {'; '.join(problems)}")
    described = tuple(
        EffectParameter(p, expression.units.get(p, expression.unit), f"{p} of {name}", linear=table is not None)
        for p in expression.parameter_names
    )
    members = {"name": name, "title": name.replace("_", " "), "parameters": described, "expression": expression}
    members["evidence"] = f"follows {'a table over ' + table.signal.replace('_', ' ') if table else formula}"
    return type(f"Expression_{name}", (_TableEffect if table is not None else _FormulaEffect,), members)


class _ExpressionEffect(Effect):
    expression: Expression

    @classmethod
    def _by_channel(cls, column: FloatArray) -> Columns:
        return {channel: factor * column for channel, factor in cls.expression.channels.items()}


class _FormulaEffect(_ExpressionEffect):
    """The formula's value; its one coefficient is 1 in a model."""

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("formula",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        signals = {name: getattr(states, name) for name in SIGNALS}
        values = {**CONSTANTS, "gear_ratio": states.gear_ratio, **signals, **shape}
        with np.errstate(all="ignore"):
            value = evaluate_formula(parse_formula(cls.expression.formula), values)
        return cls._by_channel(np.broadcast_to(np.asarray(value, dtype=float), states.time.shape)[:, None])

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        return {name: values[name] for name in cls.expression.parameter_names}, np.ones(1)

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return {name: float(value) for name, value in shape.items()}


class _TableEffect(_ExpressionEffect):
    """Hat functions; their coefficients are the values at the knots."""

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return cls.expression.parameter_names

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        assert cls.expression.table is not None
        return cls._by_channel(table_columns(cls.expression.table, states))
