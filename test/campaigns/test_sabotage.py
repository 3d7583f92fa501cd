"""Each hand-made bug alone, in memory: its named test must turn red. A text that is not found any more is a failure."""

from pathlib import Path

import pytest
from bugs import BUGS
from mutants import notices

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("name", "file", "old", "new", "test"), BUGS, ids=[bug[0].replace(" ", "_") for bug in BUGS])
def test_the_bug_is_noticed(name, file, old, new, test):
    source = (ROOT / file).read_text()
    assert source.count(old) >= 1, f"{name}: the text to break is not there any more"
    module = file.removesuffix(".py").replace("/", ".")
    selected = ["-k", "not g1_no_unsafe"] if "campaign" in test else []
    assert notices(module, source.replace(old, new, 1), [test, *selected]), f"{name} was not noticed by {test}"
