"""Seeded damage of text files: bytes, lines, words and numbers changed in the ways in which people and programs do."""

from __future__ import annotations

import random

NUMBERS = (
    "0 -1 1e-3 1e309 -1e309 .nan .inf nan inf 1e400 010 0x1F 1:30 1_000 5e-324 1e308 2147483648 18446744073709551616 "
    "1e5000 " + "9" * 30 + " " + "9" * 400 + " true null ~ ''"
).split() + ["9" * 5000]
WORDS = "on yes &a *a !!python/object:os.system <<: { } [ ] : - # | > % \t ' \"".split(" ")
WORDS += ["\x00", "\ufeff", "\u2028", "\xed\xb3\xbf", "\U0001f600", "\xe9", "__import__('os')", "../../etc/passwd"]
WORDS += ["&lol;", "<!DOCTYPE x [<!ENTITY a 'b'>]>", "<xacro:include/>", "a" * 3000]


def mutated(text: str, rng: random.Random) -> bytes:
    """One to three changes of a text; the last one may be on the bytes."""
    for _ in range(rng.randrange(1, 4)):
        text = rng.choice(TEXT_CHANGES)(text, rng)
    data = text.encode("utf-8", "surrogatepass")
    return rng.choice(BYTE_CHANGES)(data, rng) if rng.random() < 0.3 else data


def _number(text: str, rng: random.Random) -> str:
    return _token(text, rng, NUMBERS, "0123456789")


def _word(text: str, rng: random.Random) -> str:
    return _token(text, rng, WORDS, "abcdefghijklmnopqrstuvwxyz_")


def _token(text: str, rng: random.Random, choices: list[str], alphabet: str) -> str:
    """A run of characters of the alphabet replaced."""
    places = [at for at, character in enumerate(text) if character in alphabet]
    if not places:
        return text + rng.choice(choices)
    start = end = rng.choice(places)
    while end < len(text) and text[end] in alphabet + ".":
        end += 1
    return text[:start] + rng.choice(choices) + text[end:]


def _lines(text: str, rng: random.Random) -> str:
    lines = text.splitlines(keepends=True) or [""]
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    elif kind == 2:
        lines[at] = " " * rng.randrange(6) + lines[at]
    elif kind == 3:
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines = lines[: at + 1]
    return "".join(lines)


def _insert(text: str, rng: random.Random) -> str:
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(WORDS + NUMBERS) * rng.choice([1, 1, 1, 40]) + text[at:]


def _nested(text: str, rng: random.Random) -> str:
    return rng.choice(["[" * 5000, "{a: " * 3000, "- " * 3000, "<a>" * 3000, "((" * 3000, text * rng.randrange(2, 5)])


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data or b"\0")
    for _ in range(rng.randrange(1, 6)):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _noise(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randrange(1, 30)) + data[at + rng.randrange(30) :]


TEXT_CHANGES = (_number, _number, _number, _word, _lines, _lines, _insert, _nested)
BYTE_CHANGES = (_flip, _cut, _noise)
