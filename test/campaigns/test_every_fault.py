"""Every code of the fault table with name, page, action, text and a test that is called by its number."""

from __future__ import annotations

from results import write_result
from test_fault_pages import missing_parts

from hd_control.core.faults import FaultCode, pages

GOALS = ("G18",)


def test_g18_fault_pages():
    missing = {code.text: parts for code in FaultCode if (parts := missing_parts(code))}
    waiting = [code.text for code in FaultCode if pages()[code].state.startswith("open")]
    words = f"{len(FaultCode) - len(waiting)} of {len(FaultCode)} codes whole, {len(missing)} with something missing; "
    words += "not built yet: " + ", ".join(waiting)
    write_result("G18", words, not missing, missing=missing)
    assert not missing, missing
