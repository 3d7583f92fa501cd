"""One strict loader for every YAML file: YAML 1.2 numbers, no duplicate keys, no anchors, no tags, bounded size.

PyYAML's parser supplies the events; this module resolves them itself, because the usual safe loader reads `1e-3` as
text, `010` as 8, the key `on` as True, and silently takes the last of two equal keys.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode

MAX_BYTES, MAX_DEPTH, MAX_NODES = 1_000_000, 20, 50_000
MAX_DIGITS = 19
"""Of a whole number, sign included: each one fits into 64 bits and is a finite double."""

_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)$")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|nan)$", re.IGNORECASE)
_AMBIGUOUS = re.compile(r"(?i:yes|no|on|off)$|[-+]?0[0-7]+$|[-+]?0[xobXOB][0-9a-fA-F]+$|[0-9][0-9_]*(:[0-5]?[0-9])+$")


class Lines(dict[str, Any]):
    """A mapping that remembers the line of each key, for errors that come later (`lines[key]`, from 1)."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: dict[str, int] = {}


def malformed(where: str, why: str) -> ConfigError:
    """The error of a file that is not what it should be; `where` names file, line and key."""
    return ConfigError(FaultCode.YAML_BAD.line(why, where))


def load_yaml(path: str | Path) -> Any:
    """The content of one YAML file as dicts, lists, numbers, text, booleans and None.

    Raises ConfigError with file, line and key for anything that is not plain, unambiguous YAML 1.2.
    """
    path = Path(path)
    try:
        data = path.open("rb").read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read ({error.strerror})") from None
    if len(data) > MAX_BYTES:
        raise malformed(str(path), f"larger than {MAX_BYTES} bytes")
    return parse_yaml(data, str(path))


def parse_yaml(data: bytes | str, where: str = "<text>") -> Any:
    """Like `load_yaml`, from memory. `where` names the source in errors."""
    import yaml

    try:
        text = data if isinstance(data, str) else data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise malformed(where, f"not UTF-8 text (byte {error.start})") from None
    try:
        return _Composer(yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)), where).document()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        raise malformed(f"{where}{line}", getattr(error, "problem", None) or "not YAML") from None


class _Composer:
    """Builds plain data from parser events, with all limits checked on the way."""

    def __init__(self, events: Iterator[Any], where: str) -> None:
        self.events, self.where, self.nodes = events, where, 0

    def document(self) -> Any:
        value: Any = None
        documents = 0
        for event in self.events:
            kind = type(event).__name__
            if kind == "DocumentStartEvent":
                documents += 1
                if documents > 1:
                    self.refuse(event, "more than one document in the file")
                value = self.node(next(self.events), "", 0)
        return value

    def node(self, event: Any, key: str, depth: int) -> Any:
        self.nodes += 1
        if self.nodes > MAX_NODES or depth > MAX_DEPTH:
            self.refuse(event, f"more than {MAX_NODES} values or {MAX_DEPTH} levels")
        kind = type(event).__name__
        if kind == "AliasEvent" or event.anchor is not None:
            self.refuse(event, "anchors and aliases are not allowed", key)
        if event.tag is not None and event.tag != "!":
            self.refuse(event, f"tag {event.tag} is not allowed", key)
        if kind == "ScalarEvent":
            return self.scalar(event, key)
        if kind == "SequenceStartEvent":
            items: list[Any] = []
            while type(item := next(self.events)).__name__ != "SequenceEndEvent":
                items.append(self.node(item, f"{key}[{len(items)}]", depth + 1))
            return items
        return self.mapping(key, depth)

    def mapping(self, parent: str, depth: int) -> Lines:
        found = Lines()
        while type(event := next(self.events)).__name__ != "MappingEndEvent":
            if type(event).__name__ != "ScalarEvent":
                self.refuse(event, "a key must be text", parent)
            if event.anchor is not None or event.tag not in (None, "!"):
                self.refuse(event, "anchors and tags are not allowed on keys", parent)
            key = str(event.value)
            if key == "<<":
                self.refuse(event, "merge keys are not allowed", parent)
            if key in found:
                self.refuse(event, f"duplicate key {key!r}, first on line {found.lines[key]}", parent)
            found.lines[key] = event.start_mark.line + 1
            found[key] = self.node(next(self.events), f"{parent}.{key}" if parent else key, depth + 1)
        return found

    def scalar(self, event: Any, key: str) -> Any:
        text: str = event.value
        if event.style:
            return text
        if text in ("", "~", "null", "Null", "NULL"):
            return None
        if text in ("true", "True", "TRUE"):
            return True
        if text in ("false", "False", "FALSE"):
            return False
        if _INTEGER.match(text):
            if len(text) > MAX_DIGITS:
                self.refuse(event, f"a whole number of {len(text)} digits is not meant; write it as 1e20", key)
            return int(text)
        if _AMBIGUOUS.match(text):
            self.refuse(event, f"{text} is ambiguous; write a plain number, true/false, or quote it", key)
        if _NOT_FINITE.match(text) or (_FLOAT.match(text) and not math.isfinite(float(text))):
            self.refuse(event, f"{text} is not a finite number", key)
        return float(text) if _FLOAT.match(text) else text

    def refuse(self, event: Any, why: str, key: str = "") -> None:
        at = f" ({key})" if key else ""
        raise malformed(f"{self.where}, line {event.start_mark.line + 1}{at}", why)


def expect_keys(
    table: Any, where: str, required: Collection[str] = (), optional: Collection[str] = ()
) -> Mapping[str, Any]:
    """The mapping itself if it has all required and no unknown keys; else ConfigError naming line and nearest key."""
    if not isinstance(table, Mapping):
        raise malformed(where, f"expected a mapping, got {table!r:.60}")
    known = [*required, *optional]
    lines = getattr(table, "lines", {})
    problems = [f"missing key {key!r}" for key in required if key not in table]
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            line = f"line {lines[key]}: " if key in lines else ""
            problems.append(f"{line}unknown key {key!r}" + (f", did you mean {near[0]!r}?" if near else ""))
    if problems:
        raise malformed(where, "; ".join(problems))
    return table


def load_params_file(path: str | Path, node: str) -> dict[str, Any]:
    """The parameters of one node from a ROS params file: sections `/**` first, then `/**/node` or `node`.

    Raises ConfigError if the file is no params file or has no section for the node.
    """
    return params_of(load_yaml(path), str(path), node)


def params_of(document: Any, path: str, node: str) -> dict[str, Any]:
    """As `load_params_file`, from a document that is read already; `path` for the messages."""
    if not isinstance(document, Mapping):
        raise malformed(path, "not a params file; expected '/**:' with 'ros__parameters:' below it")
    found: dict[str, Any] = {}
    sections = ["/**", f"/**/{node}", f"/{node}", node]
    for name in sections:
        if name in document:
            section = expect_keys(document[name], f"{path}: {name}", ["ros__parameters"])
            found.update(_flat(section["ros__parameters"] or {}, ""))
    if not any(name in document for name in sections):
        raise malformed(path, f"no section for {node}; there is {', '.join(map(str, document))}; use '/**:'")
    return found


def _flat(table: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[prefix + key] = value
    return flat
