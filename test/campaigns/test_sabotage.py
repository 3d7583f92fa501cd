"""Each hand-made bug alone, in memory or in a fresh build: its named test must turn red.

A text that is not found any more is a failure. hd test --long SABOTAGE
"""

from __future__ import annotations

import pytest
from bugs import BUGS, OUT_OF_SCOPE
from counts import count
from results import write_result
from saboteur import is_noticed

GOALS = ("SABOTAGE",)

CHOSEN = BUGS[:: -(-len(BUGS) // count(len(BUGS)))]
NUMBERED = [bug for bug in BUGS if bug[0].split()[0][1:].isdigit()]


@pytest.fixture(scope="module")
def noticed():
    """Names of the bugs that were noticed; the result is written at the end, whatever happened."""
    found = []
    yield found
    asked, numbered = len(BUGS), sum(name.split()[0][1:].isdigit() for name in found)
    tried = "" if len(CHOSEN) == asked else f" ({len(CHOSEN)} tried)"
    words = f"{numbered} of {len(NUMBERED)} of the list, {len(found)} of {asked} with our own{tried}"
    out = ", ".join(f"{name}: {why}" for name, why in OUT_OF_SCOPE.items())
    write_result("SABOTAGE", f"{words}; not applicable yet: {out}", len(found) == asked, noticed=found)


@pytest.mark.parametrize("bug", CHOSEN, ids=[bug[0].replace(" ", "_") for bug in CHOSEN])
def test_the_bug_is_noticed(bug, noticed, tmp_path):
    assert is_noticed(bug, tmp_path), f"{bug[0]} was not noticed by {bug[4]}"
    noticed.append(bug[0])


def test_the_list_is_whole():
    """Thirty numbers, each a bug of this file or out of scope with a reason."""
    numbers = {bug[0].split()[0] for bug in NUMBERED} | set(OUT_OF_SCOPE)
    assert numbers == {f"S{k}" for k in range(1, 31)}
