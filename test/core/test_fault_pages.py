"""G18: every fault has a name, a page, an action, a test that exists and a text; the manual is current."""

import re
from pathlib import Path

import pytest

from hd_control.core.faults import Action, Fault, FaultCode, manual, pages

ROOT = Path(__file__).resolve().parents[2]


def test_the_manual_is_current():
    """python -m hd_control.core.faults > docs/faults.md"""
    assert (ROOT / "docs" / "faults.md").read_text() == manual()


def missing_parts(code):
    """What a fault lacks of name, page, action, text and a test called by its number."""
    page, found = pages()[code], []
    if min(len(part) for part in (page.meaning, page.found_by, page.action)) <= 3:
        found.append("page")
    if page.state != "built" and page.state.split(":")[0] not in ("elsewhere", "open"):
        found.append(f"state {page.state!r}")
    text = Fault(code, 0, 1.5, 1.0, Action.CONTROLLED_STOP).text()
    if not ("1.5" in text and "call reset" in text and text.startswith(code.text)):
        found.append(f"text {text!r}")
    if page.state.startswith("open"):
        return found + ([] if page.test == "-" else ["test of what is not built"])
    test = ROOT / page.test
    named = rf"def test_(?:\w*_)?f{code.value:02d}(?:_|\b)"
    if not (test.is_file() and re.search(named, test.read_text())):
        found.append(f"test_f{code.value:02d}_... in {page.test}")
    return found + ([] if page.samples else ["samples"])


@pytest.mark.parametrize("code", list(FaultCode))
def test_g18_every_fault_has_all_its_parts(code):
    assert missing_parts(code) == []


def test_the_manual_names_every_action_in_words():
    text = manual()
    assert all(f"## {code.text}\n" in text for code in FaultCode) and "not a certified safety function" in text
