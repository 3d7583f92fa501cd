"""ROS params files as text: numbers as ROS reads them, and an existing file with some values changed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.strict_yaml import parse_yaml


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
