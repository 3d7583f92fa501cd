"""G18: every fault has a name, a page, an action, a test that exists and a text; the manual is current."""

from pathlib import Path

import pytest

from hd_control.core.fault_table import manual, pages
from hd_control.core.faults import Action, Fault, FaultCode

ROOT = Path(__file__).resolve().parents[2]


def test_the_manual_is_current():
    """python -m hd_control.core.fault_table > docs/faults.md"""
    assert (ROOT / "docs" / "faults.md").read_text() == manual()


@pytest.mark.parametrize("code", list(FaultCode))
def test_g18_every_fault_has_all_its_parts(code):
    page = pages()[code]
    assert min(len(part) for part in (page.meaning, page.found_by, page.action)) > 3
    assert page.state == "built" or page.state.split(":")[0] in ("elsewhere", "open")
    text = Fault(code, 0, 1.5, 1.0, Action.CONTROLLED_STOP).text()
    assert "1.5" in text and "call reset" in text
    if page.state.startswith("open"):
        assert page.test == "-"
    else:
        assert (ROOT / page.test).is_file(), page.test
        if page.state == "built":
            assert page.samples


def test_the_manual_names_every_action_in_words():
    text = manual()
    assert all(f"## {code.text}\n" in text for code in FaultCode) and "not a certified safety function" in text
