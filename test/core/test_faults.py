"""Faults: code, name, value, limit and remedy in one line; the strongest action wins."""

import re

import pytest

from hd_control.core.faults import KINDS, Action, Fault, FaultCode, strongest


def test_text_names_everything():
    fault = Fault(FaultCode.NODE_KILLED, 2, 10.0, 10.0, Action.TORQUE_RAMP)
    assert fault.text() == (
        "HD-F18 node_killed joint_3: input age 10 samples >= 10 samples. "
        "Check that the sending node lives; then call reset."
    )
    assert " elbow: " in fault.text(("base", "shoulder", "elbow"))


@pytest.mark.parametrize("code", list(FaultCode))
def test_every_code_has_a_text_of_the_fixed_form(code):
    text = Fault(code, 0, 1.5, 1.0, Action.REPORT).text()
    assert re.fullmatch(rf"HD-F{code.value:02d} [a-z_]+ joint_1: .+\. .+\.", text)
    assert "1.5" in text
    assert "reset" not in text, "a report needs no reset"


@pytest.mark.parametrize("code", list(KINDS))
def test_every_described_code_has_a_remedy(code):
    assert len(KINDS[code].remedy) > 10 and KINDS[code].quantity


def test_codes_are_the_table_without_gaps():
    assert [code.value for code in FaultCode] == list(range(1, 44))


def test_the_strongest_action_wins():
    faults = [
        Fault(FaultCode.SPIKE, 0, 0.0, 0.0, action) for action in (Action.REPORT, Action.TORQUE_RAMP, Action.DEGRADE)
    ]
    assert strongest(faults) is Action.TORQUE_RAMP
    assert strongest([]) is Action.REFUSE
