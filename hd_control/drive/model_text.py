"""The canonical text of a model: the same model gives the same text, byte for byte."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any

from hd_control.drive.expression import Expression
from hd_control.drive.model import JointModel, Model, ModelValue, is_urdf_text

_PLAIN = re.compile(r"[A-Za-z_][\w./\-+^*() ]*(?<! )$")
_RESERVED = {"true", "false", "null", "yes", "no", "on", "off", "y", "n"}


def model_sha256(model: Model) -> str:
    """SHA-256 of the canonical text: of the file, if this program wrote it."""
    return hashlib.sha256(model_text(model).encode()).hexdigest()


def model_text(model: Model) -> str:
    """YAML of schema hd.model/1 that `drive/model_yaml.py` reads back to an equal model."""
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
            lines += [f"          {key}: {_value(value, units.get(key, ''))}" for key, value in values.items()]
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
        lines += [f"            {key}: {_value(value, expression.unit)}" for key, value in values.items()]
    return lines


def _value(value: ModelValue, unit: str) -> str:
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
