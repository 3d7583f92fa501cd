"""Seven of the hand-made bugs in the quick lane: the unit tests of gate and guard must notice each."""

from __future__ import annotations

import pytest
from bugs import BUGS, QUICK
from cpp_mutants import HEADERS
from equivalent import EQUIVALENT
from mutants import MODULES, ROOT, path_of
from saboteur import is_noticed

CHOSEN = [bug for bug in BUGS if bug[0].split()[0] in QUICK]


@pytest.mark.slow
@pytest.mark.parametrize("bug", CHOSEN, ids=[bug[0].split()[0] for bug in CHOSEN])
def test_the_bug_is_noticed(bug, tmp_path):
    assert is_noticed(bug, tmp_path), f"{bug[0]} was not noticed by {bug[4]}"


def stale_bugs(bugs):
    """Bugs whose text to break, or whose tests, are not there any more."""
    found = []
    for name, file, old, _, tests in bugs:
        path = ROOT / file
        paths = [ROOT / word for word in tests.split() if word.endswith(".py")]
        if not (path.is_file() and old in path.read_text() and paths and all(each.is_file() for each in paths)):
            found.append(name)
    return found


def stale_reasons(equivalent):
    """Lines of code with a reason that are not there any more."""
    sources = {module: path_of(module) for module in MODULES} | {header: ROOT / header for header in HEADERS}
    lines = {name: {line.strip() for line in path.read_text().splitlines()} for name, path in sources.items()}
    return [key for key in equivalent if key[1] not in lines.get(key[0], ())]


def test_the_lists_name_what_is_there():
    assert not stale_bugs(BUGS) and not stale_reasons(EQUIVALENT)
    gate = "hd_control/safety/gate.py"
    assert stale_bugs([("gone", gate, "no such text", "", "test/safety/test_safety_gate.py")]) == ["gone"]
    assert stale_bugs([("gone", gate, "import", "", "test/safety/test_gone.py")]) == ["gone"]
    assert stale_reasons([("hd_control.safety.gate", "no such line", ""), ("hd_control.gone", "x = 1", "")])
