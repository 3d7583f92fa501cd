"""Every live test has a limit: one that waits for ever is ended, and says so."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ENDLESS = """
import threading
import pytest

pytestmark = pytest.mark.process


def test_that_waits_for_what_never_comes():
    threading.Event().wait(60.0)


def test_after_it():
    pass
"""


def test_a_live_test_that_waits_for_ever_is_ended(tmp_path):
    (tmp_path / "conftest.py").write_text((ROOT / "test" / "conftest.py").read_text())
    (tmp_path / "test_endless.py").write_text(ENDLESS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml"),
               "--rootdir", str(tmp_path), str(tmp_path)]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "HD_LIVE_LIMIT": "1"}, capture_output=True, text=True)
    assert done.returncode == 1 and "1 failed, 1 passed" in done.stdout, done.stdout[-3000:]
    assert "TimeoutError" in done.stdout and "longer than 1.0 s" in done.stdout
