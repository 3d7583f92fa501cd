"""Does what a page says, in the present folder."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

from command_blocks import Command, Written, steps
from command_words import split

from hd_control.cli.main import main

PLAIN = {"cp", "mkdir", "head", "python"}


def run_page(page: Path, kinds: Collection[str]) -> int:
    """Writes the files and runs the commands of some kinds in order; returns how many commands ran.

    Raises AssertionError with the words of the command that ended otherwise than the page says.
    """
    count = 0
    for step in steps(page):
        if isinstance(step, Written):
            Path(step.name).parent.mkdir(parents=True, exist_ok=True)
            Path(step.name).write_text(step.text, encoding="utf-8")
        elif step.kind in kinds:
            run(step)
            count += 1
    return count


def run(command: Command) -> None:
    """One command line: `hd` in this process, `cd`, and a few plain tools; anything else is refused."""
    words = split(command.text)
    if words[0] == "cd":
        os.chdir(words[1])
        return
    out, err = io.StringIO(), io.StringIO()
    if words[0] in ("hd", "./hd"):
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words[1:])
    else:
        assert words[0] in PLAIN, f"{command}: a test does not run {words[0]}; mark the block"
        given = [sys.executable, *words[1:]] if words[0] == "python" else words
        done = subprocess.run(given, capture_output=True, text=False)
        code = done.returncode
        out.write(done.stdout.decode(errors="surrogateescape"))
        err.write(done.stderr.decode(errors="replace"))
    assert code == command.code, f"{command}\nexit code {code}\n{out.getvalue()[-2000:]}{err.getvalue()[-2000:]}"
    target = command.text.split("#")[0].partition(" > ")[2].strip()
    if target:
        Path(target).write_bytes(out.getvalue().encode(errors="surrogateescape"))
