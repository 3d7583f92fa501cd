"""Workers end with the process that started them, even if that one is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from hd_control.core.workers import serve_only
def work(place):
    open(place, "w").write(str(os.getpid()))
    time.sleep(120)
if __name__ == "__main__":
    with ProcessPoolExecutor(1, multiprocessing.get_context(sys.argv[1]), serve_only) as pool:
        pool.submit(work, sys.argv[2]).result()
"""


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


@pytest.mark.process
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_worker_ends_with_its_command(method: str, tmp_path: Path) -> None:
    script, place = tmp_path / "pool.py", tmp_path / "pid"
    script.write_text(SCRIPT)
    process = subprocess.Popen([sys.executable, str(script), method, str(place)], env=dict(os.environ))
    end = time.monotonic() + 60.0
    while not (place.exists() and place.read_text()) and time.monotonic() < end:
        time.sleep(0.02)
    worker = int(place.read_text())
    process.send_signal(signal.SIGKILL)
    process.wait(10.0)
    while alive(worker) and time.monotonic() < end:
        time.sleep(0.02)
    assert not alive(worker)
