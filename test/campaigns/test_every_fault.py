"""Every code of the fault table with name, page, action, line and a test that is called by its number."""

from __future__ import annotations

from results import write_result
from test_fault_pages import missing_parts

from hd_control.core.faults import RESERVED, FaultCode

GOALS = ("G18",)


def test_g18_fault_pages():
    missing = {code.text: parts for code in FaultCode if (parts := missing_parts(code))}
    words = f"{len(FaultCode) - len(missing)} of {len(FaultCode)} codes whole; {len(RESERVED)} numbers are reserved"
    write_result("G18", words, not missing, missing=missing)
    assert not missing, missing
