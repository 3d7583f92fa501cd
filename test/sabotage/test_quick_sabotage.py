"""Seven of the hand-made bugs in the quick lane: the unit tests of gate and guard must notice each."""

from __future__ import annotations

import pytest
from bugs import BUGS, QUICK
from saboteur import is_noticed

CHOSEN = [bug for bug in BUGS if bug[0].split()[0] in QUICK]


@pytest.mark.slow
@pytest.mark.parametrize("bug", CHOSEN, ids=[bug[0].split()[0] for bug in CHOSEN])
def test_the_bug_is_noticed(bug, tmp_path):
    assert is_noticed(bug, tmp_path), f"{bug[0]} was not noticed by {bug[4]}"
