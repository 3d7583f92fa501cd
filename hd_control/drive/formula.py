"""Formulas in named signals and parameters, read into a tree of whitelisted nodes; nothing is ever run as code."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError

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
