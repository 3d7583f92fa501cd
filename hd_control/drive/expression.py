"""Effects that a model file writes down itself: a formula in named signals and parameters, or a table.

    expression: {name: cable, channel: link_torque, formula: "c * sin(joint_position)", parameters: {c: 3.0}}
    expression: {name: bump, channel: motor_torque, table: {signal: joint_position, knots: [0, 1], values: [0, 2]}}

A formula is read into a tree of whitelisted nodes; nothing is ever run as code. A table is piecewise linear inside its
range and zero outside. Both are the column of their channel: torque that resists (N m), or angle that is added (rad).
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.drive.effect import (
    CHANNELS,
    GAUGE,
    LINK,
    MOTOR,
    UNITS,
    Columns,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    Shape,
)

# ---- Formulas --------------------------------------------------------------------------------------


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


TAKEN = {*SIGNALS, *FUNCTIONS, *CONSTANTS, "direction", "gear_ratio"}
"""What a parameter cannot be called."""


@lru_cache(maxsize=256)
def parse_formula(text: str) -> ast.expr:
    """The syntax tree of a formula with whitelisted nodes only. Raises ConfigError naming what does not fit, where."""
    if len(text) > MAX_LENGTH:
        raise ConfigError(f"formula longer than {MAX_LENGTH} characters")
    line = " ".join(text.split())
    try:
        tree = ast.parse(line, mode="eval").body
    except SyntaxError as error:
        raise _error(line, error.offset or 1, "not an arithmetic expression") from None
    except (ValueError, RecursionError, MemoryError):
        raise _error(line, 1, "not an arithmetic expression") from None
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.expr)]
    if len(nodes) > MAX_NODES:
        raise ConfigError(f"formula with more than {MAX_NODES} parts")
    called = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    for node in nodes:
        if problem := _node_problem(node, id(node) in called):
            raise _error(line, _column(line, node), problem)
    return tree


def check_names(formula: str, parameters: Collection[str]) -> None:
    """Raises ConfigError for the first name that is neither a signal nor one of the parameters."""
    line = " ".join(formula.split())
    known = {*TAKEN, *parameters}
    names = [node for node in ast.walk(parse_formula(formula)) if isinstance(node, ast.Name) and node.id not in known]
    for node in sorted(names, key=lambda name: name.col_offset):
        near = difflib.get_close_matches(node.id, sorted({*SIGNALS, *parameters}), 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        problem = f"{node.id!r} is no signal and has no value under parameters{hint}"
        raise _error(line, _column(line, node), problem)


def _column(line: str, node: ast.expr) -> int:
    """From 1, in letters; the tree counts bytes."""
    return len(line.encode()[: node.col_offset].decode(errors="ignore")) + 1


def _error(line: str, column: int, problem: str) -> ConfigError:
    return ConfigError(f"formula {line!r}, column {column}: {problem}")


def _node_problem(node: ast.expr, called: bool) -> str:
    """Why a node is not allowed; empty if it is."""
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
    if isinstance(node, ast.UnaryOp):
        return "" if isinstance(node.op, (ast.USub, ast.UAdd)) else f"operator {type(node.op).__name__} is not known"
    if not isinstance(node, ast.BinOp):
        return f"{type(node).__name__} is not allowed; use numbers, names, + - * / ** and {', '.join(FUNCTIONS)}"
    if type(node.op) not in _OPERATIONS:
        return f"operator {type(node.op).__name__} is not known"
    if isinstance(node.op, ast.Pow):
        power = node.right.value if isinstance(node.right, ast.Constant) else None
        if isinstance(power, bool) or not isinstance(power, (int, float)) or abs(power) > MAX_POWER:
            return f"a power must be a number up to {MAX_POWER:g}"
    return ""


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


# ---- Effects of formulas and tables ----------------------------------------------------------------


SHORT = {"direction": "motor_direction", "velocity": "motor_velocity", "torque": "joint_torque"}
"""Short names for what a table is multiplied with; `direction` is one in formulas, too."""


@dataclass(frozen=True)
class Table:
    """Piecewise-linear over one signal at `knots` (increasing), times another (`times`: "none", "direction" of the
    motor, "velocity" of the motor, "torque" of the joint, or a signal); zero outside the knots. The values at the knots
    are the parameters `value_1`, ..."""

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
        return tuple(dict.fromkeys(name for name in names if name not in TAKEN))

    @property
    def unit(self) -> str:
        """Unit of a parameter that does not name one."""
        plain = self.table is not None and self.table.times in ("none", "direction")
        return UNITS.get(next(iter(self.channels), ""), "") if plain else ""

    def effect(self) -> type[Effect]:
        """The effect class of this expression. Raises ConfigError if it cannot be used."""
        key = (self.name, tuple(self.channels.items()), self.formula, self.table, tuple(self.units.items()))
        return _effect_class(*key)


def check_expression(expression: Expression) -> list[str]:
    """What is wrong with an expression, one clause each."""
    from hd_control.drive.library import library

    problems = [
        f"channel {name!r} is not one of {', '.join(CHANNELS)}" for name in expression.channels if name not in UNITS
    ]
    if expression.name in library():
        problems.append("the library has an effect of this name; choose another")
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
        hats *= getattr(states, SHORT.get(table.times, table.times))[:, None]
    return hats


def _table_problems(table: Table) -> list[str]:
    problems = [] if table.signal in SIGNALS else [f"signal {table.signal!r} is not one of {', '.join(SIGNALS)}"]
    if table.times not in ("none", *SHORT, *SIGNALS):
        problems.append(f"times {table.times!r} is not none, {', '.join(SHORT)} or a signal")
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
    members["reads"] = GAUGE if expression.channels == {MOTOR: -1.0, LINK: 1.0} else ""
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
        """Raises ConfigError where the formula has no finite value although every signal has one."""
        value = cls._value(states, shape)
        wrong = ~np.isfinite(value)
        for name in {node.id for node in ast.walk(parse_formula(cls.expression.formula)) if isinstance(node, ast.Name)}:
            wrong &= np.isfinite(getattr(states, SHORT.get(name, name), 0.0))
        if wrong.any():
            first = int(np.argmax(wrong))
            raise ConfigError(
                f"expression {cls.name}: {cls.expression.formula!r} is {value[first]} at {states.time[first]:.3f} s"
            )
        return cls._by_channel(value[:, None])

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        return cls._by_channel(cls._value(states, shape)[:, None]), memory

    @classmethod
    def _value(cls, states: DriveStates, shape: Shape) -> FloatArray:
        signals = {name: getattr(states, name) for name in SIGNALS}
        numbers = {**CONSTANTS, "gear_ratio": states.gear_ratio, "direction": states.motor_direction}
        with np.errstate(all="ignore"):
            value = evaluate_formula(parse_formula(cls.expression.formula), {**numbers, **signals, **shape})
        return np.broadcast_to(np.asarray(value, dtype=float), states.time.shape)

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
