"""Whole commands of the workbench as a user starts them: processor time and memory of the process and its helpers."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from hd_control.bench.measure import Result, summarise
from hd_control.core.errors import HdError

PUZZLE = ("challenge", "new", "--seed", "34", "--kind", "one")
"""One joint, 60 s at 1 kHz, one effect hidden; a development seed."""


@dataclass(frozen=True)
class Usage:
    """What a command took: s of processor time, helpers included, and MB of the largest process."""

    cpu: float
    memory: float


def run_hd(*words: str) -> Usage:
    """Runs one command of `hd` in a process of its own. Raises HdError with its words if it fails."""
    command = [sys.executable, "-m", "hd_control.cli.main", *words]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            said.seek(0)
            text = said.read().decode(errors="replace").strip()
            raise HdError(f"hd {' '.join(words)}: exit code {process.returncode}: {text[-500:]}")
    return Usage(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)


def make_puzzle(folder: Path, *more: str) -> tuple[str, str]:
    """Bag and model of a recording with a hidden effect."""
    path = folder / "puzzle"
    run_hd(*PUZZLE, "-o", str(path), *more)
    return str(path / "fit"), str(path / "model.yaml")


def workbench_rows(runs: int) -> list[Result]:
    """`compare_bag`, `diagnose_joint` in CPU s and `peak_memory_compare` in MB: one joint, 60 s at 1 kHz."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        bag, model = make_puzzle(Path(folder))
        compared = [run_hd("compare", bag, "--model", model, "--quiet") for _ in range(runs)]
        diagnosed = [run_hd("diagnose", bag, "--model", model, "--quiet") for _ in range(runs)]
    return [
        summarise("compare_bag", "CPU s", [usage.cpu for usage in compared]),
        summarise("diagnose_joint", "CPU s", [usage.cpu for usage in diagnosed]),
        summarise("peak_memory_compare", "MB", [usage.memory for usage in compared]),
    ]
