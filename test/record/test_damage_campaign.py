"""Thousand damaged recordings of every form (goal G7); ten thousand run in the long campaigns."""

from __future__ import annotations

import pytest
from damaged_bags import campaign


@pytest.mark.parametrize("part", range(5))
def test_damaged_bags_never_escape_and_are_never_silently_short(tmp_path, part):
    counts = campaign(tmp_path, range(200 * part, 200 * part + 200))
    assert sum(counts.values()) == 200 and counts["partial"] > 100
