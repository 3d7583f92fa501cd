"""Parameters: unit, symbol, bounds and source in one place.

A `ParameterSet` belongs to a node or a law. The same list validates a file, declares the ROS parameters, refuses a bad
live change, bounds a fit and fills the tables of the documentation. ROS params files are written from it, too. The
parameters that a compiled law reads are the fields of its block: `parameters_of` makes the list, `field_numbers` the
numbers of the block.
"""

from __future__ import annotations

import difflib
import enum
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode
from hd_control.core.strict_yaml import parse_yaml


class Shape(enum.Enum):
    """How many values a parameter holds."""

    SCALAR = "scalar"
    PER_JOINT = "per joint"
    LIST = "list"


class Change(enum.Enum):
    """When a parameter may change (reliability rule: fixed, inactive or hot)."""

    FIXED = "read-only after start"
    INACTIVE = "needs INACTIVE"
    HOT = "live"


@dataclass(frozen=True)
class Parameter:
    """One named value with everything that is known about it.

    `low` and `high` are inclusive unless `open_low` is set; they hold for every element. `choices` restricts text.
    `live`: how far it may go while the law runs, see `LiveReach`; None: anywhere that is allowed.
    """

    name: str
    meaning: str
    unit: str = "-"
    kind: type = float
    shape: Shape = Shape.SCALAR
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    choices: tuple[str, ...] = ()
    symbol: str = ""
    source: str = ""
    change: Change = Change.INACTIVE
    live: tuple[float, float] | None = None

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.kind in (bool, str):
            return "true or false" if self.kind is bool else "text"
        left, right = ("(" if self.open_low or self.low == -math.inf else "["), ("]" if self.high < math.inf else ")")
        return f"{left}{self.low:g}, {self.high:g}{right} {self.unit}".rstrip(" -")

    def problems(self, value: Any, joints: int) -> list[str]:
        """What is wrong with `value`, one sentence each; empty if nothing is."""
        if self.shape is Shape.SCALAR:
            return self._element_problems(value, self.name)
        if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
            return [f"{self.name}: expected a list, got {value!r}"]
        if self.shape is Shape.PER_JOINT and len(value) != joints:
            return [f"{self.name}: {len(value)} values, expected {joints}, one for each joint"]
        return [text for i, item in enumerate(value) for text in self._element_problems(item, f"{self.name}[{i}]")]

    def _element_problems(self, value: Any, where: str) -> list[str]:
        if self.kind is bool:
            return [] if isinstance(value, bool) else [f"{where}: {value!r} is not true or false"]
        if self.kind is str:
            if not isinstance(value, str):
                return [f"{where}: {value!r} is not text"]
            return [f"{where}: {value!r} is not {self.allowed}"] if self.choices and value not in self.choices else []
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return [f"{where}: {value!r} is not a number"]
        if self.kind is int and not isinstance(value, int):
            return [f"{where}: {value!r} is not a whole number"]
        if isinstance(value, int) and abs(value) >= 1 << 63:
            return [f"{where}: a whole number beyond 64 bits"]
        inside = self.low < value <= self.high if self.open_low else self.low <= value <= self.high
        if not (inside and math.isfinite(value)):
            return [f"{where}: {value:g} is outside {self.allowed}"]
        return []


def live_scale(unit: str, effort: float, speed: float) -> float:
    """What a unit means at a joint of effort limit N m and velocity limit rad/s; shares are counted from it."""
    scales = {"N m": effort, "N m s": effort / speed, "1/(N m)": 1.0 / effort, "1/(N m)^2": 1.0 / effort**2}
    return scales.get(unit, effort / 100.0 if unit == "N m/K" else 1.0)


@dataclass(frozen=True)
class LiveReach:
    """How far values may go while a law runs: counted from `anchor`, the values at its activation, so that no row of
    small changes goes further. `effort` N m and `speed` rad/s: limits of the joints of every per-joint list.

    Up to the parameter's factor times as large or as small, and its share of the joint's limits on both sides.
    """

    anchor: Mapping[str, Any]
    effort: Sequence[float]
    speed: Sequence[float]

    def bounds(self, parameter: Parameter, joint: int) -> tuple[float, float]:
        """Lowest and highest value now, of one joint (0 for a number of the whole law)."""
        per_joint = parameter.shape is Shape.PER_JOINT
        start = self.anchor[parameter.name][joint] if per_joint else self.anchor[parameter.name]
        factor, share = parameter.live if parameter.live is not None else (1.0, math.inf)
        scale = live_scale(parameter.unit, self.effort[joint], self.speed[joint]) if per_joint else 1.0
        low, high = sorted((start / factor, start * factor))
        return low - share * scale, high + share * scale

    def problems(self, parameter: Parameter, value: Any) -> list[str]:
        """The elements of a changed value that go too far, one sentence each."""
        found: list[str] = []
        if parameter.live is None or parameter.kind is not float:
            return found
        for joint, item in enumerate(value if parameter.shape is Shape.PER_JOINT else [value]):
            low, high = self.bounds(parameter, joint)
            where = f"{parameter.name}[{joint}]" if parameter.shape is Shape.PER_JOINT else parameter.name
            if not low <= item <= high:
                found.append(f"{where}: {item:g} is outside [{low:g}, {high:g}] {parameter.unit} while active")
        return found


FieldRow = tuple[str, int, str, str]
"""A field of a compiled block: name, numbers per joint (0: one for all), unit, meaning."""
Allowed = tuple[str, float, float, bool, tuple[str, ...]]
"""What a field may hold: kind (a key of `KINDS`), lowest, highest, whether the lowest is excluded, words."""
KINDS: Mapping[str, type] = {"number": float, "whole": int, "truth": bool, "word": str}
ANY_NUMBER: Allowed = ("number", -math.inf, math.inf, False, ())


def parameters_of(
    fields: Sequence[FieldRow],
    allowed: Mapping[str, Allowed],
    more: Mapping[str, Mapping[str, Any]],
    without: Collection[str] = (),
    live: Mapping[str, tuple[float, float]] | None = None,
    **common: Any,
) -> tuple[Parameter, ...]:
    """The parameters that the fields of a compiled block ask for, in the order of the block.

    Name, unit, meaning and allowed values are the block's. `more` gives by field what a block does not know (symbol,
    source, change), `common` the same for all, `live` how far a field may go while the law runs. Fields in `without`
    are computed, or are parameters of another list. A field of several numbers per joint becomes numbered parameters;
    the word n of meaning and symbol becomes the number.
    Raises ValueError for a name in `more` or `without` that is no field.
    """
    strangers = {*more, *without} - {field[0] for field in fields}
    if strangers:
        raise ValueError(f"the block has no field {', '.join(sorted(strangers))}")
    chosen = (field for field in fields if field[0] not in without)
    return tuple(
        p
        for field in chosen
        for p in _parameters_of_field(
            field, allowed, {**common, "live": (live or {}).get(field[0]), **more.get(field[0], {})}
        )
    )


def _parameters_of_field(
    field: FieldRow, allowed: Mapping[str, Allowed], extras: Mapping[str, Any]
) -> Iterator[Parameter]:
    name, per_joint, unit, meaning = field
    kind, low, high, open_low, words = allowed.get(name, ANY_NUMBER)
    given: dict[str, Any] = {"name": name, "meaning": meaning, "unit": unit, "kind": KINDS[kind], "choices": words}
    given["shape"] = Shape.PER_JOINT if per_joint else Shape.SCALAR
    if kind in ("number", "whole"):
        bound: Callable[[float], float] = int if kind == "whole" else float
        given |= {"low": bound(low), "high": bound(high), "open_low": open_low}
    given |= extras
    if per_joint <= 1:
        yield Parameter(**given)
        return
    for n in range(1, per_joint + 1):
        texts = {key: re.sub(r"(?<![^\W_])n\b", str(n), given.get(key, "")) for key in ("meaning", "symbol")}
        yield Parameter(**given | texts | {"name": f"{name}_{n}"})


def field_numbers(
    fields: Sequence[FieldRow], allowed: Mapping[str, Allowed], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Checked values of parameters as numbers of the block's fields; a field without a parameter is left out.

    True is 1, a word is its number, numbered parameters become the rows (joints, numbers) of one field.
    """
    numbers: dict[str, Any] = {}
    for name, per_joint, _, _ in fields:
        if per_joint > 1:
            if f"{name}_1" in values:
                numbers[name] = np.array([values[f"{name}_{n}"] for n in range(1, per_joint + 1)]).T
        elif name in values:
            value = values[name]
            numbers[name] = allowed[name][4].index(value) if isinstance(value, str) else value
    return numbers


JOINT_NAMES = Parameter(
    "joint_names", "joints, in the order of every list", kind=str, shape=Shape.LIST, change=Change.FIXED
)

Rule = Callable[[Mapping[str, Any]], list[str]]
"""A rule between values: receives all values, returns what is wrong, one sentence each."""


@dataclass(frozen=True)
class ParameterSet:
    """The parameters of one node or law, with the rules between them."""

    owner: str
    parameters: tuple[Parameter, ...]
    rules: tuple[Rule, ...] = ()

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.owner}: a parameter is declared twice")

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in declaration order."""
        return tuple(parameter.name for parameter in self.parameters)

    def select(self, values: Mapping[str, Any], joint_names: Sequence[str]) -> dict[str, Any]:
        """The same values for some joints only: every per-joint list is reduced and ordered by `joint_names`.

        `values["joint_names"]` says which joint each list element belongs to. Raises ConfigError for a joint without
        values.
        """
        known = list(values["joint_names"])
        missing = [name for name in joint_names if name not in known]
        if missing:
            what = f"no values for {missing[0]}; joint_names has {', '.join(known)}"
            raise ConfigError(FaultCode.MODEL_MISMATCH.line(what, self.owner))
        rows = [known.index(name) for name in joint_names]
        per_joint = {p.name for p in self.parameters if p.shape is Shape.PER_JOINT}
        return {k: [v[row] for row in rows] if k in per_joint else v for k, v in values.items()} | {
            "joint_names": list(joint_names)
        }

    def problems(self, values: Mapping[str, Any], joints: int) -> list[str]:
        """Everything that is wrong with a complete set of values, one sentence each; rules run only on valid values."""
        found = []
        for name in values:
            if name not in self.names:
                near = difflib.get_close_matches(name, self.names, 1)
                found.append(
                    f"{name}: unknown parameter of {self.owner}" + (f", did you mean {near[0]}?" if near else "")
                )
        for parameter in self.parameters:
            if parameter.name not in values:
                found.append(f"{parameter.name}: missing ({parameter.meaning}, {parameter.allowed})")
            else:
                found.extend(parameter.problems(values[parameter.name], joints))
        if not found:
            found = [text for rule in self.rules for text in rule(values)]
        return found

    def check(self, values: Mapping[str, Any], joints: int, where: str = "") -> None:
        """Raises ConfigError that lists every problem of the whole set; changes nothing."""
        found = self.problems(values, joints)
        if found:
            raise ConfigError(FaultCode.PARAM_BAD.line("; ".join(found), where or self.owner))

    def refusal(
        self,
        before: Mapping[str, Any],
        after: Mapping[str, Any],
        joints: int,
        active: bool,
        reach: LiveReach | None = None,
    ) -> str:
        """Why a change of values is refused, in one line; empty if it may be made. `active`: the law runs.

        `reach`: how far values may go then.
        """
        if found := self.problems(after, joints):
            return FaultCode.PARAM_BAD.line("; ".join(found), self.owner)
        changed = [p.name for p in self.parameters if after[p.name] != before[p.name]] if active else []
        still = [name for name in changed if self[name].change is not Change.HOT]
        found = [f"{name}: {before[name]!r} stays, a change needs INACTIVE" for name in still]
        if reach is not None:
            found += [text for name in changed for text in reach.problems(self[name], after[name])]
        return FaultCode.PARAM_MOVING.line("; ".join(found), self.owner) if found else ""


# ---- ROS params files as text: numbers as ROS reads them, and an existing file with some values changed ----


def yaml_value(value: Any) -> str:
    """A parameter's value as ROS reads it: a float has a point, also before an exponent."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(yaml_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value if re.fullmatch(r"[A-Za-z_][\w./-]*", value) else '"' + value.replace('"', '\\"') + '"'
    if isinstance(value, int):
        return str(value)
    mantissa, exponent, power = repr(float(value)).partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{exponent}{power}"


def with_changes(text: str, changes: Mapping[str, Any], remark: str, where: str = "<params>") -> str:
    """The text of a params file with some values changed, everything else as it stands.

    A line with a changed value gets `remark` behind its comment; values that the file does not have are appended.
    Raises ConfigError for a file that writes such a value over several lines or twice.
    """
    lines, missing = text.rstrip("\n").split("\n"), dict(changes)
    for index, line in enumerate(lines):
        found = re.fullmatch(r"(\s+)([\w.]+):\s+(\[[^\]#]*\]|[^\s#\[]+)\s*(?:#\s*(.*))?", line)
        if found is None or found[2] not in missing:
            continue
        space, name, _, comment = found.groups()
        words = f"{comment}; {remark}" if comment else remark
        lines[index] = f"{space}{name}: {yaml_value(missing.pop(name))}  # {words}"
    if missing:
        indent = next((re.match(r"\s*", line)[0] for line in reversed(lines) if line.strip()), "    ")  # type: ignore[index]
        lines += [f"{indent}{name}: {yaml_value(value)}  # {remark}" for name, value in missing.items()]
    written = "\n".join(lines) + "\n"
    if any(len(re.findall(rf"^\s+{re.escape(name)}:", written, re.MULTILINE)) != 1 for name in changes):
        raise ConfigError(
            f"{where}: a value stands in the file twice or over several lines; write one line per parameter"
        )
    parse_yaml(written, where)
    return written


def params_text(values: Mapping[str, Any]) -> str:
    """A params file of one node, for every node that reads it."""
    lines = [f"    {name}: {yaml_value(value)}" for name, value in values.items()]
    return "/**:\n  ros__parameters:\n" + "\n".join(lines) + "\n"
