"""The tests that only calculate, in processes of their own beside those that start nodes."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ALONE = "HD_TEST_ALONE"
"""Set in the environment of the second run: it starts no third."""
LIVE = "process"
"""Mark of the tests that start processes or look at a wall clock; all others may run beside anything."""


def narrowed(options: Sequence[str], expression: str) -> list[str]:
    """Options of pytest that choose, of the tests chosen by `options`, those with a mark."""
    found = list(options)
    for k, word in enumerate(found[:-1]):
        if word == "-m":
            found[k + 1] = f"({found[k + 1]}) and {expression}"
            return found
    return [*found, "-m", expression]


def _yield_to_live_nodes() -> None:
    """In the new process: runs only where nothing else wants to, and gives way at once."""
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except OSError:
        os.nice(19)


def _spread() -> list[str]:
    """Options that spread the files over all processors: the live half leaves one and a half of two unused."""
    if importlib.util.find_spec("xdist") is None:
        return []
    return ["-n", str(os.cpu_count() or 1), "--dist", "loadfile"]


class SecondRun:
    """Starts `hd test` on what only calculates; `finish` prints what it said and returns its document."""

    def __init__(self, root: Path, options: Sequence[str]) -> None:
        self._place = tempfile.TemporaryDirectory(prefix="hd_test_")
        self._document = Path(self._place.name) / "outcome.json"
        self._log = Path(self._place.name) / "log"
        command = [sys.executable, "-m", "hd_control.cli.main", "test", "--json", str(self._document)]
        with self._log.open("wb") as log:
            command += [*narrowed(options, f"not {LIVE}"), *_spread(), str(root / "test")]
            self._process = subprocess.Popen(
                command, cwd=root, stdout=log, stderr=subprocess.STDOUT, preexec_fn=_yield_to_live_nodes,
                env={**os.environ, ALONE: "1"},
            )  # fmt: skip

    @staticmethod
    def worth_it(options: Sequence[str]) -> bool:
        """True with two or more processors, unless a debugger is wanted: that needs the terminal."""
        alone = ALONE in os.environ or (os.cpu_count() or 1) == 1
        return not alone and not {"--pdb", "--trace"}.intersection(options)

    def finish(self) -> dict[str, Any]:
        """Waits, prints, and returns counts, failures and exit code. A run that died counts as exit code 3."""
        try:
            code = self._process.wait()
            sys.stdout.write(self._log.read_text(errors="replace"))
            sys.stdout.flush()
            if not self._document.exists():
                return {"passed": 0, "failed": 0, "skipped": 0, "failures": [], "exit_code": code or 3}
            found: dict[str, Any] = json.loads(self._document.read_text())
            return found
        finally:
            if self._process.poll() is None:
                self._process.terminate()
                self._process.wait()
            self._place.cleanup()
