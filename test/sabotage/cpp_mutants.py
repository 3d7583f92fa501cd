"""Small changes of the compiled safety rules: every place in one build, one of them switched on by HD_MUTANT.

An operator or a constant lies in an expression that ends at brackets, commas and operators that bind less: that is the
slot in which `original` becomes `(hd_mutant == 12 ? (changed) : (original))`. Expressions inside it have slots of their
own. Left out: preprocessor lines, headers of `for`, and arithmetic of sizes and places in memory.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from builds import ROOT

SAFETY, GUARD, SENSORS = (f"hd_control/cpp/{name}.hpp" for name in ("safety", "guard", "sensor_watch"))
SIDE = "hd_sim/cpp/drive_side.hpp"
_GATE, _GUARD = "test/safety/test_safety_gate.py", "test/safety/test_guard.py"
_LIMITS, _SENSORS = "test/safety/test_sensor_limits.py", "test/safety/test_sensor_monitors.py"
_SIDE = ("test/hd_sim/test_drive_seam.py", "test/hd_sim/test_brakes.py", "test/hd_sim/test_drive_side_oracle.py")
_TEMPERATURES = "test/safety/test_temperatures.py"
_ORACLES = ("test/safety/test_guard_oracle.py", "test/chain/test_stages_oracle.py")
HEADERS = {
    SAFETY: (_GATE, _GUARD, _LIMITS, _SENSORS, *_ORACLES),
    GUARD: (_GUARD, _GATE, *_ORACLES),
    SENSORS: (_LIMITS, _SENSORS, _TEMPERATURES, _ORACLES[1]),
    SIDE: _SIDE,
}
"""Header -> files of its tests, in the order in which they are tried."""
SWITCH = "hd_control/cpp/hd_mutant.hpp"
SWITCH_TEXT = """#pragma once
#include <cstdio>
#include <cstdlib>
inline const int hd_mutant = std::getenv("HD_MUTANT") == nullptr ? 0 : std::atoi(std::getenv("HD_MUTANT"));
inline bool hd_probe(int number, bool value) {
    static bool seen[2][4096];
    if (!seen[value][number] && std::getenv("HD_PROBES") != nullptr) {
        seen[value][number] = true;
        if (std::FILE* file = std::fopen(std::getenv("HD_PROBES"), "a")) {
            std::fprintf(file, "%d %d\\n", number, value ? 1 : 0);
            std::fclose(file);
        }
    }
    return value;
}
"""
"""Number of the mutant that is switched on, and a note of how a condition has ended."""

TOKEN = re.compile(
    r"(?P<skip>\s+|//[^\n]*|/\*.*?\*/|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*)|(?P<text>\"(?:\\.|[^\"])*\"|'(?:\\.|[^'])*')"
    r"|(?P<number>\d+\.?\d*(?:e[-+]?\d+)?)|(?P<word>\w+)"
    r"|(?P<mark><<=|>>=|->|::|\+\+|--|<=|>=|==|!=|&&|\|\||\+=|-=|\*=|/=|&=|\|=|.)",
    re.DOTALL | re.MULTILINE,
)
BINDS = {"||": 1, "&&": 2, "==": 3, "!=": 3, "<": 4, "<=": 4, ">": 4, ">=": 4, "+": 5, "-": 5, "*": 6, "/": 6, "%": 6}
OTHER = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "&&": "||", "||": "&&", "+": "-", "-": "+",
         "*": "/", "/": "*"}  # fmt: skip
ENDS = {";", ",", "=", "?", ":", "{", "}", "return", "+=", "-=", "*=", "/=", "&=", "|=", "else"}
PLACES = {"at", "size", "kGuardRows", "reserve", "resize"}
"""Calls whose arguments are sizes or places in memory."""
ADDRESSES = re.compile(
    r"\.data\(\)|\.begin\(\)|\brefusals \+|\bbound \+|\b(?:low|high|shaft) \+ n\b|\bguard_limits \+"
    r"|\b(?:from|joint_velocity) \+ n\b|\bgear_ratio \+ joints\b"
)


@dataclass(frozen=True)
class Token:
    """One word, number or mark of a source, and where it begins."""

    kind: str
    text: str
    start: int

    @property
    def end(self) -> int:
        """Where it ends."""
        return self.start + len(self.text)


@dataclass(frozen=True)
class Mutant:
    """One change: its number, the header, its line, what was done, the line of code, and the slot as changed."""

    number: int
    header: str
    line: int
    change: str
    code: str
    slot: tuple[int, int]
    text: str


class Source:
    """A header as tokens with their brackets."""

    def __init__(self, text: str) -> None:
        self.text = text
        found = (Token(match.lastgroup or "", match[0], match.start()) for match in TOKEN.finditer(text))
        self.tokens = [token for token in found if token.kind != "skip"]
        self.partner: dict[int, int] = {}
        self.around: list[list[int]] = []
        stack: list[int] = []
        for i, token in enumerate(self.tokens):
            if token.text in (")", "]", "}") and token.kind == "mark":
                opened = stack.pop()
                self.partner[i], self.partner[opened] = opened, i
            self.around.append([*stack])
            if token.text in ("(", "[", "{") and token.kind == "mark":
                stack.append(i)

    def spaced(self, i: int) -> bool:
        """Does a mark stand between blanks, as binary operators do here, and template brackets and pointers do not?"""
        token = self.tokens[i]
        return self.text[token.start - 1].isspace() and self.text[token.end].isspace()

    def binary(self, i: int) -> int:
        """How strongly an operator between blanks binds; 0: it is none."""
        token = self.tokens[i]
        return BINDS.get(token.text, 0) if token.kind == "mark" and self.spaced(i) else 0

    def slot(self, i: int, binds: int, step: int) -> int:
        """The last token of the expression around token `i`, to the left (-1) or to the right (1)."""
        opening = "([{" if step < 0 else ")]}"
        at = i + step
        while 0 <= at < len(self.tokens):
            token = self.tokens[at]
            if token.kind == "mark" and token.text in opening or token.text in ENDS:
                break
            if 0 < self.binary(at) < binds:
                break
            at = self.partner.get(at, at) + step
        return at - step

    def is_free(self, i: int) -> bool:
        """No part of a `for` header, a size, a place in memory, or a list that initialises members."""
        for opened in self.around[i]:
            before = self.tokens[opened - 1] if opened else self.tokens[0]
            head = self.text[max(0, self.tokens[opened].start - 26) : self.tokens[opened].start]
            if self.tokens[opened].text == "[" or before.text in ("for", *PLACES) or head.endswith("<std::size_t>"):
                return False
        return True

    def span(self, first: int, last: int) -> tuple[int, int]:
        """Places of a run of tokens in the text."""
        return self.tokens[first].start, self.tokens[last].end


def _changes(source: Source) -> Iterator[tuple[int, str, tuple[int, int], str]]:
    """Token, words, slot and its changed text, for every place of a header."""
    text = source.text
    for i, token in enumerate(source.tokens):
        if not source.is_free(i):
            continue
        before = source.tokens[i - 1] if i else token
        if source.binary(i) and token.text in OTHER:
            slot = source.span(source.slot(i, source.binary(i), -1), source.slot(i, source.binary(i), 1))
            new = text[slot[0] : token.start] + OTHER[token.text] + text[token.end : slot[1]]
            yield i, f"{token.text} -> {OTHER[token.text]}", slot, new
        elif token.kind == "number" and "." in token.text:
            value = float(token.text)
            new = "0.0" if value == 1.0 else repr(value + 1.0) if value < 1e15 else repr(0.5 * value)
            yield i, f"{token.text} -> {new}", source.span(i, i), new
        elif token.text in ("true", "false"):
            new = "false" if token.text == "true" else "true"
            yield i, f"{token.text} -> {new}", source.span(i, i), new
        elif token.text in ("!", "-") and not source.spaced(i) and before.text not in (")", "]") and _leads(before):
            slot = source.span(i, source.slot(i, 7, 1))
            yield i, f"{token.text} removed", slot, text[token.end : slot[1]]
        elif token.text in ("+=", "-="):
            slot = source.span(i + 1, source.slot(i, 1, 1))
            yield i, "sign of the step", slot, f"-({text[slot[0] : slot[1]]})"
        for slot in _condition(source, i):
            yield i, "condition -> true", slot, "true"
            yield i, "condition -> false", slot, "false"


def _leads(before: Token) -> bool:
    """May a sign follow this token? After a name or a number it would be an operator."""
    return before.kind == "mark" or before.text == "return"


def _condition(source: Source, i: int) -> list[tuple[int, int]]:
    """The slot of the condition that belongs to an `if`, a `while` or a `?`."""
    token = source.tokens[i]
    if token.text in ("if", "while") and source.tokens[i + 1].text == "(":
        return [source.span(i + 2, source.partner[i + 1] - 1)]
    if token.text == "?" and source.is_free(i):
        return [source.span(source.slot(i, 1, -1), i - 1)]
    return []


@lru_cache
def _source(header: str) -> Source:
    return Source((ROOT / header).read_text())


@lru_cache
def mutants() -> tuple[Mutant, ...]:
    """Every mutant of every header, numbered from 1."""
    found: list[Mutant] = []
    for header in HEADERS:
        source = _source(header)
        for i, change, slot, text in _changes(source):
            line = source.text.count("\n", 0, source.tokens[i].start) + 1
            code = source.text.splitlines()[line - 1].strip()
            if not ADDRESSES.search(source.text[slot[0] : slot[1]]):
                found.append(Mutant(len(found) + 1, header, line, change, code, slot, text))
    return tuple(found)


def switched() -> dict[str, str]:
    """The headers with every mutant in them, and the switch; path -> text."""
    found = {SWITCH: SWITCH_TEXT}
    for header in HEADERS:
        slots: dict[tuple[int, int], list[tuple[str, str]]] = {}
        for mutant in mutants():
            if mutant.header == header:
                slots.setdefault(mutant.slot, []).append((f"hd_mutant == {mutant.number}", mutant.text))
        found[header] = _with_slots(header, slots)
    return found


def conditions() -> list[tuple[str, int, tuple[int, int]]]:
    """Header, line and slot of every condition."""
    return [(m.header, m.line, m.slot) for m in mutants() if m.change == "condition -> true"]


def probed() -> dict[str, str]:
    """The headers with every condition noting how it ends; its number is its place in `conditions`."""
    found = {SWITCH: SWITCH_TEXT}
    for header in HEADERS:
        slots = {slot: [(f"#{n}", "")] for n, (file, _, slot) in enumerate(conditions()) if file == header}
        found[header] = _with_slots(header, slots)
    return found


def _with_slots(header: str, slots: dict[tuple[int, int], list[tuple[str, str]]]) -> str:
    text = _source(header).text
    order = sorted(slots, key=lambda slot: (slot[0], -slot[1]))
    body = _rendered(text, 0, len(text), order, slots)
    body = re.sub(r"^constexpr (double|std::int64_t) (?=.*hd_mutant)", r"inline const \1 ", body, flags=re.MULTILINE)
    return body.replace("#pragma once", '#pragma once\n#include "hd_mutant.hpp"', 1)


def _rendered(text, start, end, order, slots):  # type: ignore[no-untyped-def]
    """A part of the text with its slots filled, the inner ones inside the original of the outer ones."""
    parts, at = [], start
    while order and order[0][0] < end:
        slot = order.pop(0)
        inner = [each for each in order if each[1] <= slot[1]]
        del order[: len(inner)]
        original = _rendered(text, *slot, inner, slots)
        parts += [text[at : slot[0]], _filled(original, slots[slot])]
        at = slot[1]
    return "".join([*parts, text[at:end]])


def _filled(original: str, choices: list[tuple[str, str]]) -> str:
    if choices[0][0].startswith("#"):
        return f"hd_probe({choices[0][0][1:]}, ({original}))"
    switches = " : ".join(f"{condition} ? ({changed})" for condition, changed in choices)
    return f"({switches} : ({original}))"
