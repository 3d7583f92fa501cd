"""10 000 damaged recordings of every form and class; nothing escapes, nothing is silently short."""

from __future__ import annotations

import resource

from counts import count
from damaged_bags import campaign
from results import write_result

GOALS = ("G7",)

CASES, FIRST = count(10_000), 1000
MOST_MEMORY = 256 << 20


def test_g7_damaged_bags(tmp_path):
    """The numbers begin behind those of the quick part, so that both together are 11 000 different cases."""
    counts = campaign(tmp_path, range(FIRST, FIRST + CASES))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    passed = sum(counts.values()) == CASES and peak < MOST_MEMORY
    words = ", ".join(f"{number} {kind}" for kind, number in counts.items())
    write_result(
        "G7",
        f"{CASES} damaged bags: {words}; 0 escapes, 0 silently short; {peak >> 20} MB",
        passed and CASES >= 10_000,
        **counts,
    )
    assert passed
