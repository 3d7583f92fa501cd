"""Puts one hand-made bug in the place of the real code, in a process of its own, and asks a test."""

from __future__ import annotations

import shlex
from pathlib import Path

from builds import ROOT, build, users_of
from mutants import notices, notices_libraries


def is_noticed(bug: tuple[str, str, str, str, str], folder: Path) -> bool:
    """Does the bug's test turn red? Raises AssertionError if the text to break is not there any more.

    A bug in a header is built into every module that takes it in.
    """
    name, file, old, new, tests = bug
    source = (ROOT / file).read_text()
    assert source.count(old) == 1, f"{name}: the text to break is not there any more, or more than once"
    broken, asked = source.replace(old, new, 1), shlex.split(tests)
    if file.endswith(".py"):
        return notices(file.removesuffix(".py").replace("/", "."), broken, asked)
    return notices_libraries(build({file: broken}, users_of(file), folder), asked)
