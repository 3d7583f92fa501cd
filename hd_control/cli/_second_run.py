"""The half of the test suite that only calculates, in processes of its own beside the half that starts nodes."""

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

CALCULATING = ("analysis", "control", "core", "drive", "hd_sim", "oracles", "reproduce", "sensing", "stages")
"""Folders of `test` without processes and without a wall clock: they may run beside anything."""

LOW = 15
"""Nice value of the calculating half."""


def _spread() -> list[str]:
    """Options that spread the files over all processors: the live half leaves one and a half of two unused."""
    if importlib.util.find_spec("xdist") is None:
        return []
    return ["-n", str(os.cpu_count() or 1), "--dist", "loadfile"]


class SecondRun:
    """Starts `hd test` on the calculating folders; `finish` prints what it said and returns its document."""

    def __init__(self, root: Path, options: Sequence[str]) -> None:
        self.folders = [root / "test" / name for name in CALCULATING if (root / "test" / name).is_dir()]
        self._place = tempfile.TemporaryDirectory(prefix="hd_test_")
        self._document = Path(self._place.name) / "outcome.json"
        self._log = Path(self._place.name) / "log"
        command = [sys.executable, "-m", "hd_control.cli.main", "test", "--json", str(self._document)]
        with self._log.open("wb") as log:
            command += [*options, *_spread(), *map(str, self.folders)]
            self._process = subprocess.Popen(command, cwd=root, stdout=log, stderr=subprocess.STDOUT)
        os.setpriority(os.PRIO_PROCESS, self._process.pid, LOW)  # live nodes come first

    @staticmethod
    def worth_it(options: Sequence[str]) -> bool:
        """True with two or more processors, unless a debugger is wanted: that needs the terminal."""
        return (os.cpu_count() or 1) > 1 and not {"--pdb", "--trace"}.intersection(options)

    @property
    def left_out(self) -> list[str]:
        """Options of pytest for the other half."""
        return [f"--ignore={folder}" for folder in self.folders]

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
