"""Model files, schema hd.model/1: strict YAML in, canonical YAML out. See docs/model.md.

The same model gives the same text, byte for byte.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.files import write_whole
from hd_control.core.strict_yaml import expect_keys, parse_yaml
from hd_control.drive.effect import Context, Effect, EffectParameter
from hd_control.drive.expression import Expression, Table, check_names
from hd_control.drive.model import SOURCES, JointModel, Model, ModelValue, is_urdf_text

# ---- The canonical text ----------------------------------------------------------------------------


_PLAIN = re.compile(r"[A-Za-z_][\w./\-+^*() ]*(?<! )$")
_RESERVED = {"true", "false", "null", "yes", "no", "on", "off", "y", "n"}


def model_sha256(model: Model) -> str:
    """SHA-256 of the canonical text: of the file, if this program wrote it."""
    return hashlib.sha256(model_text(model).encode()).hexdigest()


def model_text(model: Model) -> str:
    """YAML of schema hd.model/1 that `parse_model` reads back to an equal model."""
    lines = ["schema: hd.model/1"]
    if model.robot is not None:
        lines += _robot_lines(model.robot)
    lines.append("joints:")
    for name, joint in model.joints.items():
        lines += [f"  {word(name)}:", *_joint_lines(joint)]
    if model.provenance:
        lines.append("provenance:")
        lines += [line for step in model.provenance for line in _step_lines(step)]
    return "\n".join(lines) + "\n"


def _robot_lines(robot: str) -> list[str]:
    """A file by name; a description as block text if that reads back exactly, else quoted."""
    if not is_urdf_text(robot):
        return [f"robot: {{urdf: {word(robot)}}}"]
    body = robot.removesuffix("\n")
    plain = not body.endswith("\n") and body[0] == "<" and body.replace("\n", "").replace("\t", "").isprintable()
    if not plain:
        return ["robot:", f"  urdf_text: {json.dumps(robot)}"]
    mark = "|" if robot.endswith("\n") else "|-"
    return ["robot:", f"  urdf_text: {mark}", *(f"    {line}" if line else "" for line in body.split("\n"))]


def _step_lines(step: Mapping[str, Any]) -> list[str]:
    """One step of the provenance."""
    lines = [f"{key}: {word(str(value))}" for key, value in step.items() if key != "bags"]
    if bags := step.get("bags"):
        lines.append("bags:")
        lines += [f"  - {{path: {word(str(bag['path']))}, sha256: {word(str(bag['sha256']))}}}" for bag in bags]
    return [f"  {'- ' if i == 0 else '  '}{line}" for i, line in enumerate(lines)]


def _joint_lines(joint: JointModel) -> list[str]:
    lines = [f"    gear_ratio: {number(joint.gear_ratio)}"]
    if joint.rated_torque is not None:
        lines.append(f"    rated_torque: {number(joint.rated_torque)}")
    if not joint.effects:
        return [*lines, "    effects: []"]
    lines.append("    effects:")
    classes = joint.effect_classes()
    for name, values in joint.effects.items():
        if name in joint.expressions:
            lines += _expression_lines(joint.expressions[name], values)
        elif values:
            units = {parameter.name: parameter.unit for parameter in classes[name].parameters}
            lines.append(f"      - {name}:")
            lines += [f"          {key}: {_value_text(value, units.get(key, ''))}" for key, value in values.items()]
        else:
            lines.append(f"      - {name}: {{}}")
    return lines


def _expression_lines(expression: Expression, values: Mapping[str, ModelValue]) -> list[str]:
    channels = expression.channels
    plain = len(channels) == 1 and next(iter(channels.values())) == 1.0
    factors = ", ".join(f"{name}: {number(factor)}" for name, factor in channels.items())
    lines = [
        "      - expression:",
        f"          name: {word(expression.name)}",
        f"          channel: {next(iter(channels)) if plain else '{' + factors + '}'}",
    ]
    if expression.table is not None:
        table = expression.table
        knots = ", ".join(number(knot) for knot in table.knots)
        lines += ["          table:", f"            signal: {table.signal}", f"            knots: [{knots}]"]
        lines.append(f"            times: {table.times}")
    else:
        lines.append(f"          formula: {json.dumps(expression.formula)}")
    if values:
        lines.append("          parameters:")
        lines += [f"            {key}: {_value_text(value, expression.unit)}" for key, value in values.items()]
    return lines


def _value_text(value: ModelValue, unit: str) -> str:
    """One value; `unit`: what a reader takes if none is written. A plain number if there is nothing else to say."""
    parts = [f"value: {number(value.value)}"]
    if value.unit or unit:
        parts.append(f"unit: {word(value.unit or unit)}")
    if math.isfinite(value.low):
        parts.append(f"low: {number(value.low)}")
    if math.isfinite(value.high):
        parts.append(f"high: {number(value.high)}")
    if value.source:
        parts.append(f"source: {value.source}")
    if value.interval is not None:
        parts.append(f"interval: [{number(value.interval[0])}, {number(value.interval[1])}]")
    bare = (
        value.unit in ("", unit)
        and not value.source
        and value.interval is None
        and not any(map(math.isfinite, (value.low, value.high)))
    )
    return number(value.value) if bare else "{" + ", ".join(parts) + "}"


def number(value: float) -> str:
    """The shortest text that reads back as the same number, in every YAML version: 1.0e-05, never 1e-05."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{mark}{exponent}" if mark else text


def word(text: str) -> str:
    """Text as YAML: bare where that cannot be mistaken, else in double quotes."""
    bare = _PLAIN.match(text) is not None and text.lower() not in _RESERVED
    return text if bare else json.dumps(text)


# ---- Reading and saving ----------------------------------------------------------------------------


SCHEMA = "hd.model/1"
MAX_BYTES = 1_000_000
VALUE_KEYS = ("unit", "low", "high", "source", "interval")


def load_model(path: str | Path) -> Model:
    """Reads a user's model file, or a shipped one by name (`arm_a`). Raises ConfigError naming file, line and key."""
    from hd_control.core.resources import find_config

    name = str(path)
    found = find_config(name if name.endswith((".yaml", ".yml")) else f"{name}.yaml", "models")
    try:
        data = found.open("rb").read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{found}: cannot read ({error.strerror})") from None
    return parse_model(data, str(found), found.parent)


def parse_model(data: bytes | str, where: str = "<model>", folder: Path | None = None) -> Model:
    """A model from the text of a file. Raises ConfigError naming `where`, line and key."""
    if len(data) > MAX_BYTES:
        raise ConfigError(f"{where}: larger than {MAX_BYTES} bytes")
    table = expect_keys(parse_yaml(data, where), where, ["schema", "joints"], ["robot", "provenance"])
    if table["schema"] != SCHEMA:
        raise ConfigError(f"{where}: schema {table['schema']!r} is not {SCHEMA}")
    joints = table["joints"]
    if not isinstance(joints, Mapping) or not joints:
        raise ConfigError(f"{where}: joints: expected joint names with their models")
    found = {str(name): _joint(value, f"{where}: {name}") for name, value in joints.items()}
    return Model(_robot(table.get("robot"), where), found, _provenance(table.get("provenance"), where), folder)


def _robot(given: Any, where: str) -> str | None:
    """File name, shipped name or URDF text; a bare text is a file name."""
    if given is None or isinstance(given, str):
        return given
    table = expect_keys(given, f"{where}: robot", (), ["urdf", "urdf_text"])
    if len(table) != 1:
        raise ConfigError(f"{where}: robot: give either urdf (a file) or urdf_text")
    (key, text), *_ = table.items()
    if not isinstance(text, str) or not text.strip():
        raise ConfigError(f"{_place(f'{where}: robot', table, key)}: {text!r:.60} is not text")
    if is_urdf_text(text) != (key == "urdf_text"):
        raise ConfigError(
            f"{_place(f'{where}: robot', table, key)}: a file is given as urdf, a description as urdf_text"
        )
    return text


def _place(where: str, table: Any, key: str) -> str:
    """Where an entry stands: file, keys and, as far as known, line."""
    line = getattr(table, "lines", {}).get(key)
    return f"{where}: {key}" + (f" (line {line})" if line else "")


def _joint(table: Any, where: str) -> JointModel:
    expect_keys(table, where, ["gear_ratio", "effects"], ["rated_torque"])
    at_ratio, at_rated = (_place(where, table, key) for key in ("gear_ratio", "rated_torque"))
    ratio, rated = _number(table["gear_ratio"], at_ratio), table.get("rated_torque")
    if ratio <= 0.0:
        raise ConfigError(f"{at_ratio}: {ratio:g} must be positive; a reversing gear is a sign of the encoder")
    if rated is not None and _number(rated, at_rated) <= 0.0:
        raise ConfigError(f"{at_rated}: {rated:g} N m must be positive")
    if not isinstance(table["effects"], list):
        raise ConfigError(f"{where}: effects: expected a list of effects")
    effects: dict[str, Mapping[str, ModelValue]] = {}
    expressions: dict[str, Expression] = {}
    for item in table["effects"]:
        name, values, at = _item(item, where)
        expression = None
        if name == "expression":
            expression, values = _expression(values, at)
            name = expression.name
        if name in effects:
            raise ConfigError(f"{at}: effect {name!r} twice")
        effects[name] = _effect(name, values, at, expression)
        if expression is not None:
            expressions[name] = expression
    return JointModel(ratio, None if rated is None else float(rated), effects, expressions)


def _item(item: Any, where: str) -> tuple[str, Mapping[str, Any], str]:
    """Name, values and place of one entry of the list of effects."""
    if isinstance(item, str):
        return item, {}, f"{where}: {item}"
    if not isinstance(item, Mapping) or len(item) != 1:
        raise ConfigError(f"{where}: effects: {item!r:.60} is not one effect; write '- name: {{parameter: value}}'")
    name, values = next(iter(item.items()))
    at = _place(where, item, name)
    if values is not None and not isinstance(values, Mapping):
        raise ConfigError(f"{at}: expected its parameters, got {values!r:.60}")
    return str(name), values or {}, at


def _effect(name: str, values: Mapping[str, Any], at: str, expression: Expression | None) -> dict[str, ModelValue]:
    """Checked values of one effect."""
    from hd_control.drive.library import effect_named

    try:
        effect = expression.effect() if expression is not None else effect_named(name)
    except ConfigError as error:
        raise ConfigError(f"{at}: {error}") from None
    known = {parameter.name: parameter for parameter in effect.parameters}
    expect_keys(values, at, (), list(known))
    bare = at.partition(" (line ")[0]
    found = {key: _value(value, known[key], _place(bare, values, key)) for key, value in values.items()}
    try:
        missing = _missing(effect, found)
    except ArithmeticError as error:
        raise ConfigError(f"{at}: the values cannot be calculated with ({error}); is one of them 0?") from None
    if missing:
        raise ConfigError(f"{at}: missing {', '.join(missing)}")
    return found


def _missing(effect: type[Effect], found: Mapping[str, ModelValue]) -> list[str]:
    """Parameters without which the effect means nothing."""
    missing = [p.name for p in effect.parameters if not p.linear and p.default is None and p.name not in found]
    if missing:
        return missing
    if not found and all(p.default is None for p in effect.parameters):
        return [p.name for p in effect.parameters[:2]]
    try:
        effect.split({name: value.value for name, value in found.items()}, Context(1.0, 1.0, 1.0))
    except KeyError as error:
        return [str(error.args[0])]
    return []


def _value(given: Any, parameter: EffectParameter, where: str) -> ModelValue:
    if not isinstance(given, Mapping):
        value = ModelValue(_number(given, where), parameter.unit)
    else:
        expect_keys(given, where, ["value"], VALUE_KEYS)
        unit, source = given.get("unit", parameter.unit), given.get("source", "")
        if unit != parameter.unit:
            raise ConfigError(f"{where}: unit {unit!r} is not {parameter.unit!r}; convert the value")
        if source and source not in SOURCES:
            raise ConfigError(f"{where}: source {source!r} is not one of {', '.join(SOURCES)}")
        value = ModelValue(
            _number(given["value"], where),
            unit,
            _number(given.get("low", -math.inf), f"{where}: low"),
            _number(given.get("high", math.inf), f"{where}: high"),
            source,
            _interval(given.get("interval"), f"{where}: interval"),
        )
    low, high = max(value.low, parameter.low), min(value.high, parameter.high)
    if not low <= value.value <= high:
        raise ConfigError(f"{where}: {value.value:g} {parameter.unit} is outside [{low:g}, {high:g}]")
    return value


def _interval(given: Any, where: str) -> tuple[float, float] | None:
    if given is None:
        return None
    if not isinstance(given, list) or len(given) != 2:
        raise ConfigError(f"{where}: expected [low, high]")
    low, high = (_number(end, where) for end in given)
    if low > high:
        raise ConfigError(f"{where}: {low:g} is above {high:g}")
    return low, high


def _expression(given: Mapping[str, Any], at: str) -> tuple[Expression, Mapping[str, Any]]:
    """An expression and the values of its parameters, as given."""
    table = expect_keys(given, at, ["name", "channel"], ["formula", "table", "parameters"])
    name, channel = table["name"], table["channel"]
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigError(f"{at}: name: {name!r} is not a plain word")
    channels = {channel: 1.0} if isinstance(channel, str) else channel
    if not isinstance(channels, Mapping):
        raise ConfigError(f"{at}: channel: expected a channel, or channels with factors")
    factors = {str(key): _number(value, f"{at}: channel: {key}") for key, value in channels.items()}
    values: Mapping[str, Any] = table.get("parameters") or {}
    written = None
    if table.get("table") is not None:
        parts = expect_keys(table["table"], f"{at}: table", ["signal", "knots"], ["values", "times"])
        knots = tuple(_number(knot, f"{at}: knots") for knot in _list(parts["knots"], f"{at}: knots"))
        written = Table(str(parts["signal"]), knots, str(parts.get("times") or "none"))
        if "values" in parts:
            numbers = _list(parts["values"], f"{at}: values")
            if len(numbers) != len(knots):
                raise ConfigError(f"{at}: {len(numbers)} values for {len(knots)} knots")
            values = {f"value_{i + 1}": number for i, number in enumerate(numbers)}
    formula = str(table.get("formula") or "")
    if formula and written is None:
        try:
            check_names(formula, [str(key) for key in values])
        except ConfigError as error:
            raise ConfigError(f"{_place(at.partition(' (line ')[0], table, 'formula')}: {error}") from None
    units = {k: str(v["unit"]) for k, v in values.items() if isinstance(v, Mapping) and "unit" in v}
    bare = Expression(name, factors, formula, written)
    return replace(bare, units={key: unit for key, unit in units.items() if unit != bare.unit}), values


def _provenance(given: Any, where: str) -> tuple[dict[str, Any], ...]:
    """The steps that made the file."""
    steps = []
    for step in _list(given if given is not None else [], f"{where}: provenance"):
        table = expect_keys(step, f"{where}: provenance", (), ["command", "program", "bags"])
        bags = [dict(expect_keys(bag, f"{where}: bags", ["path", "sha256"])) for bag in table.get("bags") or []]
        words = {key: str(value) for key, value in table.items() if key != "bags"}
        steps.append({**words, **({"bags": bags} if bags else {})})
    return tuple(steps)


def _list(given: Any, where: str) -> list[Any]:
    if not isinstance(given, list):
        raise ConfigError(f"{where}: expected a list")
    return given


def _number(given: Any, where: str) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise ConfigError(f"{where}: {given!r} is not a number")
    return float(given)


def save_model(
    model: Model, path: str | Path, provenance: Mapping[str, Any] | None = None, force: bool = False
) -> Model:
    """Writes the canonical text, whole or not at all, and returns the model as written. Raises ConfigError.

    An existing file is replaced only with `force`. `provenance`: one more step. A robot description that does not lie
    beside the new file, as the model names it, is written into it.
    """
    path = Path(path)
    if path.exists() and not force:
        raise ConfigError(f"{path}: exists; choose another name or use --force")
    steps = (*model.provenance, *([] if provenance is None else [dict(provenance)]))
    written = replace(model, robot=_robot_for(model, path.parent), folder=path.parent, provenance=steps)
    text = model_text(written)
    if len(text.encode()) > MAX_BYTES:
        raise ConfigError(f"{path}: the model would be larger than {MAX_BYTES} bytes; put its URDF beside it as a file")
    _read_back(text, written, path)
    write_whole(path, text, ConfigError)
    return written


def _read_back(text: str, written: Model, path: Path) -> None:
    """Raises ConfigError if the text of a model is not one that `load_model` reads, with the same values."""
    try:
        found = parse_model(text, str(path), path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: not written, for it could not be read again: {error}") from None
    for name, joint in written.joints.items():
        if any(found.joint(name).numbers(effect) != joint.numbers(effect) for effect in joint.effects):
            raise ConfigError(f"{path}: not written, for {name} would be read with other values")


def _robot_for(model: Model, folder: Path) -> str | None:
    """How a model written to `folder` names its robot: the same file if that is found from there, else the text."""
    robot = model.robot
    if robot is None or is_urdf_text(robot):
        return robot
    here, there = (model.folder or Path()) / robot, folder / robot
    try:
        if not here.is_file() or (model.folder is None and there.is_file() and not Path(robot).is_absolute()):
            return robot
        text = here.read_bytes()
        same = there.is_file() and there.read_bytes() == text
        return robot if same and not Path(robot).is_absolute() else text.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{here}: cannot read ({error})") from None
