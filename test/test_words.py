"""Words that a control engineer would stumble over stand nowhere: code, documents, tests, configuration, file names."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOTS = "hunt|chas(?=e|ing)|ghost|lack|desk|tell|told|leftover"
END = "(?:e|ed|er|ers|ing|s|es)?(?![a-z])"
CAMEL = "|".join(root.capitalize() for root in ROOTS.split("|"))
WORD = re.compile(rf"(?<![A-Za-z])(?i:(?:{ROOTS}){END})|(?<=[a-z])(?:{CAMEL}){END}")
VERDICT = re.compile(r"cannot[ _]tell", re.IGNORECASE)
"""The one use that stays: the verdict of a diagnosis on a recording that cannot decide."""
PHRASES = ("what a torque that the gauge adds does", "blocks that only they themselves tell anything of")
OLD = {"CHANGELOG.md", "test/test_words.py"}
"""The history, which is not rewritten, and this list."""


def found_in(text: str) -> list[str]:
    """Words of one line that are to be avoided; `cannot tell` is none."""
    rest = VERDICT.sub("", text)
    return [match[0] for match in WORD.finditer(rest)] + [phrase for phrase in PHRASES if phrase in text.lower()]


def tracked() -> list[str]:
    """Files of the repository; skips where there is no checkout."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("needs the git checkout")
    return [name for name in done.stdout.split("\0") if name and name not in OLD and (ROOT / name).is_file()]


def test_nothing_is_named_so() -> None:
    assert not [name for name in tracked() if found_in(name)]


def test_nothing_is_written_so() -> None:
    places, read = [], 0
    for name in tracked():
        data = (ROOT / name).read_bytes()
        if b"\0" in data:  # recordings and pictures
            continue
        read += 1
        for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), 1):
            places += [f"{name}:{number}: {word}" for word in found_in(line)]
    assert read > 400 and not places, "\n".join(places)


@pytest.mark.parametrize(
    "text",
    [
        "what the model lacks",
        "Hunting for an effect",
        "self._told = 1",
        "class GoalDesk:",
        "goal_desk.py",
        "the leftovers",
        "a chasing loop",
        "it tells apart",
        "test_what_is_told_twice",
        "blocks that only they themselves tell anything of",
    ],
)
def test_a_word_to_avoid_is_seen(text: str) -> None:
    assert found_in(text)


@pytest.mark.parametrize(
    "text",
    [
        "black box",
        "slack",
        "CANNOT_TELL",
        "this recording cannot tell",
        "a satellite",
        "purchase",
        "stellar",
        "desktop",
    ],
)
def test_other_words_are_free(text: str) -> None:
    assert not found_in(text)
