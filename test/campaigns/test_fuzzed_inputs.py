"""Byte and text fuzz of every file that comes from outside, 20 000 cases."""

from __future__ import annotations

from results import write_result
from targets import check_case, targets

GOALS = ("FUZZ",)

CASES, FIRST = 2000, 60


def test_fuzz_inputs(tmp_path):
    """The numbers begin behind those of the quick part."""
    found = {}
    for name, target in targets().items():
        found[name] = sum(check_case(tmp_path, name, target, number) for number in range(FIRST, FIRST + CASES))
    words = ", ".join(f"{name} {taken} taken" for name, taken in found.items())
    write_result("FUZZ", f"{CASES} cases of each: {words}; the rest refused, nothing else left", True, **found)
    assert all(taken < CASES for taken in found.values())
