"""G18: every fault has a name, a page, an action, a line made by the code, and a test that is called by its number."""

import re
from pathlib import Path

import pytest

from hd_control.core.faults import KINDS, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_yaml
from hd_control.pages.fault_page import IN_WORDS, fault_page, fault_pages, raised

ROOT = Path(__file__).resolve().parents[2]


def missing_parts(code, root=ROOT):
    """What is missing of a fault's name, page, action, line and a test called by its number."""
    page, found = fault_pages()[code], []
    if min(len(part) for part in (page.meaning, page.found_by, page.samples, page.action)) < 1:
        found.append("page")
    if (page.example is not None, bool(page.remedy)) != (code in KINDS, code not in KINDS):
        found.append("an example if it compares numbers, else a remedy")
    line = raised(code)
    if not re.fullmatch(rf"{code.text}[ :].{{20,}}", line):
        found.append(f"line {line!r}")
    test = root / page.test
    named = rf"def test_(?:\w*_)?f{code.value:02d}(?:_|\b)"
    if not (test.is_file() and re.search(named, test.read_text())):
        found.append(f"test_f{code.value:02d}_... in {page.test}")
    return found


@pytest.mark.parametrize("code", list(FaultCode), ids=lambda code: code.text)
def test_g18_every_fault_has_all_its_parts(code):
    assert missing_parts(code) == []


def test_a_test_that_does_not_exist_is_noticed(tmp_path):
    assert missing_parts(FaultCode.SPIKE, tmp_path) == ["test_f05_... in test/safety/test_sensor_monitors.py"]


def test_every_fault_is_raised_with_numbers_or_in_words():
    assert set(IN_WORDS) == set(FaultCode) - set(KINDS)


def test_there_is_no_entry_without_a_fault():
    assert set(load_yaml(config_path("fault_pages.yaml"))) == {code.name.lower() for code in FaultCode}


def test_the_manual_shows_every_line_and_the_reserved_numbers():
    text = fault_page()
    assert all(f"## {code.text}\n" in text and f"```text\n{raised(code)}\n```" in text for code in FaultCode)
    assert "not a certified safety function" in text and "11 to 14 (a CAN bridge)" in text
