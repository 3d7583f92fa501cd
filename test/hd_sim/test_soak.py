"""Goal G10, short: 12 s of the whole arm twice; the hour runs in the long campaigns."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from soak import soak

TICKS = 12_000


def test_two_runs_are_equal_complete_and_do_not_grow(tmp_path):
    first, again = (soak(tmp_path / f"bag{number}", TICKS, seed=3) for number in range(2))
    assert first.sha256 == again.sha256
    for run in (first, again):
        assert (run.recorded, run.problems) == (TICKS, 0)
        assert abs(run.blocks_per_tick) < 0.005, "less than one object in 200 ticks stays behind"
    assert soak(tmp_path / "other", 3000, seed=4).sha256 != soak(tmp_path / "again", 3000, seed=3).sha256
