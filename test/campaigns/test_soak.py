"""Goal G10: an hour of the whole arm twice, 3.6 million ticks each: every sample there once, equal hashes, flat memory.

hd test --long -k soak -s          # HD_SOAK_SECONDS=86400 for a day
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "hd_sim"))
from soak import soak

SECONDS = int(os.environ.get("HD_SOAK_SECONDS", "3600"))
MOST_GROWTH = 1 << 20
"""Bytes per simulated hour."""


def test_g10_soak(tmp_path):
    runs = []
    for number in range(2):
        bag = tmp_path / f"bag{number}"
        runs.append(soak(bag, SECONDS * 1000, 3, lambda tick: print(f"{tick // 1000} s", end=" ", flush=True)))
        print(f"\nG10 run {number}: {runs[-1]}")
        for path in bag.iterdir():
            path.unlink()
    assert runs[0].sha256 == runs[1].sha256
    for run in runs:
        assert (run.recorded, run.problems) == (SECONDS * 1000, 0)
        assert run.bytes_per_hour < MOST_GROWTH
