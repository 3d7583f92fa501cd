"""Steps of the story that are `hd` commands of their own: run as a user would, in a process that knows no more."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hd_control.core.errors import HdError
from hd_control.nodes.children import Children, child_environment

PATIENCE = 600.0
"""s after which a command counts as stuck."""
FINE = (0, 3)
"""Exit codes that give an answer: done, and partly read."""


class Commands:
    """Runs `hd` commands in a folder; their text goes to FOLDER/logs, their answer is the JSON that they write."""

    def __init__(
        self, folder: Path, tell: Callable[[str], None], domain: int | None = None, gently: bool = False
    ) -> None:
        """`gently`: leave the processor to nodes that run on the wall clock."""
        self._folder, self._tell, self._domain, self._nice = folder, tell, domain, 10 if gently else 0

    def run(self, words: Sequence[str], answer: str, allowed: Sequence[int] = FINE) -> dict[str, Any]:
        """Runs `hd WORDS --json ANSWER` returns the JSON. Raises HdError with the command's own line if it fails."""
        shown = f"hd {shlex.join(words)}"
        self._tell(shown)
        log = self._folder / "logs" / f"{Path(answer).stem}.txt"
        log.parent.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "hd_control.cli.main", *words, "--json", answer, "--force"]
        children = Children(child_environment(self._domain, real_time=False))
        with log.open("wb") as stream:
            process = children.start("hd", command, stdout=stream, stderr=stream, cwd=self._folder)
            try:
                if self._nice:
                    os.setpriority(os.PRIO_PROCESS, process.pid, self._nice)
                end = time.monotonic() + PATIENCE
                while process.poll() is None and time.monotonic() < end:
                    time.sleep(0.02)
            finally:
                _end(process)
        if process.returncode not in allowed:
            lines = log.read_text(errors="replace").strip().splitlines()
            why = lines[-1].removeprefix("hd: ") if lines else f"exit code {process.returncode}"
            raise HdError(f"{shown}: {why}")
        found: dict[str, Any] = json.loads((self._folder / answer).read_text(encoding="utf-8"))
        return found


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a command that still runs, with the workers of its group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(3.0)
