"""Where each signal of a joint comes from: topic, field, unit, sign. The topics of this package, or a foreign bag's.

A mapping file (`--map`) turns foreign topics, fields, columns, joint names, signs and units into this project's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError
from hd_control.core.resources import find_config
from hd_control.core.strict_yaml import expect_keys, load_yaml
from hd_control.core.topics import TOPICS, signal_places
from hd_control.lab.signals.joint_signals import SIGNALS

DEGREE = np.pi / 180.0
AT_STAMPS = "measured_at_stamps"
"""Key of a bag's session record: the signals in it, by name, that were measured at their stamps and are not held."""
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "angle": {"rad": (1.0, 0.0), "mrad": (1e-3, 0.0), "deg": (DEGREE, 0.0), "turn": (2.0 * np.pi, 0.0)},
    "torque": {
        "Nm": (1.0, 0.0),
        "mNm": (1e-3, 0.0),
        "kNm": (1e3, 0.0),
        "Ncm": (1e-2, 0.0),
        "lbf ft": (1.3558179483314, 0.0),
        "lbf in": (0.1129848290276, 0.0),
        "ozf in": (0.00706155181422604, 0.0),
    },
    "temperature": {"degC": (1.0, 0.0), "K": (1.0, -273.15), "degF": (5.0 / 9.0, -160.0 / 9.0)},
    "velocity": {"rad/s": (1.0, 0.0), "deg/s": (DEGREE, 0.0), "rpm": (np.pi / 30.0, 0.0)},
}
"""Quantity -> unit -> (factor, offset) to rad, N m, deg C, rad/s: value * factor + offset."""
QUANTITIES = {
    "motor_shaft_position": "angle",
    "joint_position": "angle",
    "reference_position": "angle",
    "gauge_torque": "torque",
    "motor_torque": "torque",
    "temperature": "temperature",
    "joint_velocity": "velocity",
}
"""Signals that a mapping may name. `joint_velocity` is carried by import for the reader's eyes; no channel needs it."""


@dataclass(frozen=True)
class SignalSource:
    """One signal in a bag (`topic`, `field`) or in a table (`columns`), and how it becomes SI.

    SI value = sign * scale * (raw in `unit`) + offset, each one number or one per joint. `wrap`: the range after which
    the raw angle starts again (360 for degrees), 0 if it does not. `delay` s: the signal is late by this much.
    `held`: the value stays until the next stamp (a command); else it was measured at its stamp. `acts_later`: samples
    between stamp and effect. `columns`: names in a CSV or NPZ file, `{joint}` standing for the source's joint name.
    """

    signal: str
    topic: str = ""
    field: str = ""
    unit: str = ""
    sign: float | Mapping[str, float] = 1.0
    scale: float | Mapping[str, float] = 1.0
    offset: float | Mapping[str, float] = 0.0
    wrap: float = 0.0
    delay: float = 0.0
    held: bool = False
    acts_later: int = 0
    columns: str | Mapping[str, str] = ""

    def convert(self, joint: str, raw: FloatArray) -> FloatArray:
        """The signal in SI, (n,), NaN where it was NaN; wrapped angles become continuous."""
        values = raw
        if self.wrap > 0.0:
            finite = np.isfinite(raw)
            values = np.full(raw.shape, np.nan)
            values[finite] = np.unwrap(raw[finite], period=self.wrap)
        factor, zero = UNITS[QUANTITIES[self.signal]][self.unit] if self.unit else (1.0, 0.0)
        sign, scale, offset = (_of(number, joint, default) for number, default in self._numbers())
        if (factor, zero, sign, scale, offset) == (1.0, 0.0, 1.0, 1.0, 0.0):
            return values
        converted: FloatArray = sign * scale * (values * factor + zero) + offset
        return converted

    def _numbers(self) -> Sequence[tuple[float | Mapping[str, float], float]]:
        return (self.sign, 1.0), (self.scale, 1.0), (self.offset, 0.0)


@dataclass(frozen=True)
class TimeSource:
    """The time of a table: column, unit in s; `period` s if the samples are even and only their stamps are not."""

    column: str = ""
    unit: float = 1.0
    period: float = 0.0


@dataclass(frozen=True)
class SourceMap:
    """All sources: per signal those that may be there, the best first. `joints`: our name -> name in the source.

    No `joints` means that every joint keeps its name.
    """

    name: str
    signals: Mapping[str, Sequence[SignalSource]]
    joints: Mapping[str, str] = field(default_factory=dict)
    time: TimeSource = TimeSource()

    def ours(self, source_joint: str) -> str | None:
        """Our name of a joint of the source; None if the mapping leaves it out."""
        if not self.joints:
            return source_joint
        return next((ours for ours, theirs in self.joints.items() if theirs == source_joint), None)


def held_from_measured(column: FloatArray) -> FloatArray:
    """What, held from tick to tick, stands for a torque that was measured at the ticks: the mean over each tick."""
    mean: FloatArray = column.copy()
    mean[:-1] = 0.5 * (column[:-1] + column[1:])
    return mean


def _of(number: float | Mapping[str, float], joint: str, default: float) -> float:
    return float(number.get(joint, default) if isinstance(number, Mapping) else number)


def _standard() -> SourceMap:
    """What `core/topics` says as sources, without `joint_velocity`, which no channel needs."""
    places = signal_places()
    table = {
        signal: tuple(
            SignalSource(signal, topic, array, held=TOPICS[topic].held, acts_later=TOPICS[topic].acts_later)
            for topic, array in places[signal]
        )
        for signal in SIGNALS
    }
    return SourceMap("standard", table)


STANDARD = _standard()
"""The topics of this package (docs/reference/nodes.md)."""


# ---- The mapping file ------------------------------------------------------------------------------
#
#     joints: {joint_1: axis_a1, joint_2: axis_a2}       # ours: theirs; or a list of names that stay
#     time: {column: t, unit: ms}                        # tables only
#     signals:
#       joint_position: {topic: /joint_states, field: position, unit: deg}
#       motor_torque: {topic: /drives, field: effort, unit: mNm, scale: 100, sign: {joint_2: -1}}
#
# Strict YAML: unknown keys, signals, units and joints are errors with file and line. The manual is docs/signals.md.


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
