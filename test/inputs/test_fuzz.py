"""Every file that comes from outside: taken, or refused with one error; nothing else leaves, nothing stays behind."""

from __future__ import annotations

import pytest
from targets import Target, check_case, targets

TARGETS = targets()
CASES = 60


@pytest.mark.parametrize("name", TARGETS)
def test_any_file_is_taken_or_refused(tmp_path, name):
    """The same cases each time; the long campaign runs more of them."""
    taken = sum(check_case(tmp_path, name, TARGETS[name], number) for number in range(CASES))
    assert 0 < CASES - taken


@pytest.mark.parametrize("name", TARGETS)
def test_the_seeds_are_right(tmp_path, name):
    target: Target = TARGETS[name]
    for number, seed in enumerate(target.seeds):
        (tmp_path / str(number)).mkdir()
        target.read(tmp_path / str(number), seed.encode("utf-8"))
