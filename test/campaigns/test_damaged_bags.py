"""Goal G7: 10 000 damaged recordings of every form and class; nothing escapes, nothing is silently short."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "record"))
from damaged_bags import campaign

CASES, PARTS = 10_000, 20
MOST_MEMORY = 256 << 20


@pytest.mark.parametrize("part", range(PARTS))
def test_g7_damaged_bags(tmp_path, part):
    """The numbers begin behind those of the quick part, so that both together are 11 000 different cases."""
    size = CASES // PARTS
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    counts = campaign(tmp_path, range(1000 + size * part, 1000 + size * (part + 1)))
    print(f"G7 part {part}: {counts}")
    assert sum(counts.values()) == size
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    assert peak < MOST_MEMORY or peak == before
