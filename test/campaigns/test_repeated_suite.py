"""The quick tests of the safety rules again and again, each time with another seed; no second try."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from counts import SEED, count, enough
from results import write_result

GOALS = ("G22",)

ROOT = Path(__file__).resolve().parents[2]
REPEATS = 50
TESTS = (
    "test/safety",
    "test/laws/test_goal_check.py",
    "test/chain",
    "test/hd_sim/test_fault_campaign.py",
    "test/hd_sim/test_clock_jumps.py",
    "test/hd_sim/test_drive_seam.py",
    "test/hd_sim/test_recording_failures.py",
    "test/record",
    "test/inputs",
    "test/core",
    "test/nodes/test_parameter_service.py",
    "test/nodes/test_loop_parts.py",
)


def test_g22_repeats():
    repeats, failed = count(REPEATS), []
    for number in range(repeats):
        environment = {**os.environ, "HD_SEED": str(SEED + number), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *TESTS]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        failed += [] if done.returncode == 0 else [f"seed {SEED + number}:\n{done.stdout[-1500:]}"]
    words = f"{len(failed)} of {repeats} repeats{enough(repeats, REPEATS)} with a failure, seeds from {SEED} on"
    write_result("G22", words, not failed and repeats >= REPEATS, repeats=repeats)
    assert not failed, "\n".join(failed[:3])
