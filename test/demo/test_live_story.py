"""The demo's end by Ctrl-C, on live nodes in lock-step. The whole story is `hd test --long DEMO`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.process


def test_ctrl_c_leaves_no_process_and_names_what_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    command = [sys.executable, "-m", "hd_control.cli.main", "demo", "--lockstep", "--single-joint", "-o", str(folder)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in a suite in the background
    )
    assert process.stdout is not None
    for line in process.stdout:
        if "excitation:" in line:
            break
    end = time.monotonic() + 60.0
    while not (folder / "excitation").exists() and time.monotonic() < end:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert error.startswith("hd: interrupted; kept in") and "excitation" in error and error.count("\n") == 1
    assert not [text for text in running() if str(folder) in text]


def running() -> list[str]:
    """Command lines of all processes."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            found.append(path.read_text().replace("\0", " "))
        except OSError:
            continue
    return found
