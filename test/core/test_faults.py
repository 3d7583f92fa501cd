"""Faults: code, name, value, limit and remedy in one line; the strongest action wins."""

import re

import pytest

from hd_control.core.faults import KINDS, RESERVED, Action, Fault, FaultCode, strongest


def test_text_names_everything():
    fault = Fault(FaultCode.NODE_KILLED, 2, 10.0, 10.0, Action.TORQUE_RAMP)
    assert fault.text() == (
        "HD-F18 node_killed joint_3: input age 10 samples >= 10 samples. "
        "Check that the sending node lives; then call reset."
    )
    assert " elbow: " in fault.text(("base", "shoulder", "elbow"))


@pytest.mark.parametrize("code", list(KINDS))
def test_every_code_with_numbers_has_a_text_of_the_fixed_form(code):
    text = Fault(code, 0, 1.5, 1.0, Action.REPORT).text()
    assert re.fullmatch(rf"HD-F{code.value:02d} [a-z_]+ joint_1: .+\. .+\.", text)
    assert "1.5" in text
    assert "reset" not in text, "a report needs no reset"


@pytest.mark.parametrize("code", list(KINDS))
def test_every_described_code_has_a_remedy(code):
    assert len(KINDS[code].remedy) > 10 and KINDS[code].quantity


def test_a_line_of_words_has_the_same_form():
    assert FaultCode.GOAL_BAD.line("no points. Give one.") == "HD-F22 goal_bad: no points. Give one."
    assert FaultCode.GOAL_BAD.line("unknown joint", "joint_9") == "HD-F22 goal_bad joint_9: unknown joint"
    assert FaultCode.SPIKE.number == "HD-F05"


def test_every_number_is_a_code_or_reserved():
    numbers = [code.value for code in FaultCode]
    assert not set(numbers) & set(RESERVED)
    assert sorted([*numbers, *RESERVED]) == list(range(1, max(numbers) + 1)), "no hole, none twice"


def test_numbers_and_names_of_old_recordings_stay():
    """A sample of what is in recordings and black boxes already."""
    kept = {3: "value_frozen", 18: "node_killed", 22: "goal_bad", 30: "disk_full", 33: "exception", 43: "overspeed"}
    assert {number: FaultCode(number).text for number in kept} == {
        number: f"HD-F{number:02d} {name}" for number, name in kept.items()
    }


def test_the_strongest_action_wins():
    faults = [
        Fault(FaultCode.SPIKE, 0, 0.0, 0.0, action) for action in (Action.REPORT, Action.TORQUE_RAMP, Action.DEGRADE)
    ]
    assert strongest(faults) is Action.TORQUE_RAMP
    assert strongest([]) is Action.REFUSE
