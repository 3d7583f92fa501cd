"""The mapping file (`--map`): foreign topics, fields, columns, joint names, signs and units become this project's.

    joints: {joint_1: axis_a1, joint_2: axis_a2}       # ours: theirs; or a list of names that stay
    time: {column: t, unit: ms}                        # tables only
    signals:
      joint_position: {topic: /joint_states, field: position, unit: deg}
      motor_torque: {topic: /drives, field: effort, unit: mNm, scale: 100, sign: {joint_2: -1}}

Strict YAML: unknown keys, signals, units and joints are errors with file and line. The manual is docs/signals.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.analysis.sources import QUANTITIES, UNITS, SignalSource, SourceMap, TimeSource
from hd_control.core.errors import ConfigError
from hd_control.core.resources import find_config
from hd_control.core.strict_yaml import expect_keys, load_yaml

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
FIELDS = ("position", "velocity", "effort", "temperature", "data")
FOLDER = "maps"
_SIGNAL_KEYS = ("topic", "field", "columns", "unit", "sign", "scale", "offset", "wrap", "delay", "held")
_HELD_BY_DEFAULT = ("motor_torque",)


def load_mapping(name_or_path: str | Path) -> SourceMap:
    """A user's mapping file, or a shipped one by name (`iiwa`, `ur10`). Raises ConfigError with file and line."""
    name = str(name_or_path)
    path = find_config(name if name.endswith((".yaml", ".yml")) else f"{name}.yaml", FOLDER)
    return parse_mapping(load_yaml(path), str(path))


def parse_mapping(document: Any, where: str) -> SourceMap:
    """The mapping of a loaded document. Raises ConfigError."""
    table = expect_keys(document, where, ["signals"], ["about", "joints", "time"])
    joints = _joints(table.get("joints"), f"{where}: joints")
    signals = expect_keys(table["signals"], f"{where}: signals", [], list(QUANTITIES))
    if not signals:
        raise ConfigError(f"{where}: signals: at least one is needed; there is {', '.join(QUANTITIES)}")
    found = {name: (_signal(name, entry, f"{where}: {name}", joints),) for name, entry in signals.items()}
    return SourceMap(where, found, joints, _time(table.get("time"), f"{where}: time"))


def _joints(entry: Any, where: str) -> dict[str, str]:
    if entry is None:
        return {}
    names = entry if isinstance(entry, list) else []
    texts = [*entry.items()] if isinstance(entry, Mapping) else [(name, name) for name in names]
    pairs = {ours: theirs for ours, theirs in texts if isinstance(ours, str) and isinstance(theirs, str)}
    if not pairs or "" in {*pairs, *pairs.values()} or (len(pairs) < len(set(map(str, names)))):
        raise ConfigError(f"{where}: expected a list of names or 'ours: theirs', got {entry!r:.60}")
    if len(set(pairs.values())) < len(pairs) or (isinstance(entry, list) and len(pairs) < len(entry)):
        raise ConfigError(f"{where}: a joint is named twice")
    return pairs


def _time(entry: Any, where: str) -> TimeSource:
    if entry is None:
        return TimeSource()
    table = expect_keys(entry, where, [], ["column", "unit", "period"])
    unit = table.get("unit", "s")
    if unit not in TIME_UNITS:
        raise ConfigError(f"{where}: unit {unit!r} is not one of {', '.join(TIME_UNITS)}")
    period = _number(table.get("period", 0.0), f"{where}: period", low=0.0)
    if not table.get("column") and period == 0.0:
        raise ConfigError(f"{where}: name a column, or give the period in seconds")
    return TimeSource(_text(table.get("column", ""), f"{where}: column"), TIME_UNITS[unit], period)


def _signal(name: str, entry: Any, where: str, joints: Mapping[str, str]) -> SignalSource:
    table = expect_keys(entry, where, [], _SIGNAL_KEYS)
    topic, field = _text(table.get("topic", ""), f"{where}: topic"), table.get("field", "")
    columns = _columns(table.get("columns", ""), f"{where}: columns", joints)
    if not topic and not columns:
        raise ConfigError(f"{where}: name a topic (with its field) or columns")
    if topic and field not in FIELDS:
        raise ConfigError(f"{where}: field {field!r} is not one of {', '.join(FIELDS)}")
    units = UNITS[QUANTITIES[name]]
    unit = table.get("unit", "")
    if unit not in (*units, ""):
        raise ConfigError(f"{where}: unit {unit!r} is not one of {', '.join(units)}")
    held = table.get("held", name in _HELD_BY_DEFAULT)
    if not isinstance(held, bool):
        raise ConfigError(f"{where}: held: expected true or false, got {held!r:.60}")
    sign = _per_joint(table.get("sign", 1.0), f"{where}: sign", joints)
    if any(value not in (-1.0, 1.0) for value in (sign.values() if isinstance(sign, Mapping) else [sign])):
        raise ConfigError(f"{where}: sign: expected 1 or -1; use scale for other numbers")
    return SignalSource(
        name,
        topic,
        str(field),
        str(unit),
        sign,
        _per_joint(table.get("scale", 1.0), f"{where}: scale", joints),
        _per_joint(table.get("offset", 0.0), f"{where}: offset", joints),
        _number(table.get("wrap", 0.0), f"{where}: wrap", low=0.0),
        _number(table.get("delay", 0.0), f"{where}: delay"),
        held,
        columns=columns,
    )


def _columns(entry: Any, where: str, joints: Mapping[str, str]) -> str | dict[str, str]:
    if not isinstance(entry, Mapping):
        return _text(entry, where)
    _check_joints(entry, where, joints)
    return {str(joint): _text(column, f"{where}.{joint}") for joint, column in entry.items()}


def _per_joint(entry: Any, where: str, joints: Mapping[str, str]) -> float | dict[str, float]:
    if not isinstance(entry, Mapping):
        return _number(entry, where)
    _check_joints(entry, where, joints)
    return {str(joint): _number(value, f"{where}.{joint}") for joint, value in entry.items()}


def _check_joints(entry: Mapping[str, Any], where: str, joints: Mapping[str, str]) -> None:
    if joints:
        expect_keys(entry, where, [], list(joints))


def _number(value: Any, where: str, low: float = -np.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value < low:
        limit = f" of at least {low:g}" if np.isfinite(low) else ""
        raise ConfigError(f"{where}: expected a number{limit}, got {value!r:.60}")
    return float(value)


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise ConfigError(f"{where}: expected text, got {value!r:.60}")
    return value
