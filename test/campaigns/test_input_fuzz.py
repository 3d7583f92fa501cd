"""Section 12 of the reliability contract: byte and text fuzz of every file that comes from outside, 20 000 cases."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "inputs"))
from targets import check_case, targets

TARGETS = targets()
CASES = 2000


@pytest.mark.parametrize("name", TARGETS)
def test_input_fuzz(tmp_path, name):
    """The numbers begin behind those of the quick part."""
    taken = sum(check_case(tmp_path, name, TARGETS[name], number) for number in range(60, 60 + CASES))
    print(f"{name}: {CASES} cases, {taken} taken, {CASES - taken} refused, 0 other")
    assert taken < CASES
