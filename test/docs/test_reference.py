"""The generated pages say what the code says."""

from __future__ import annotations

from pathlib import Path

import pytest

from hd_control.lab.signals.joint_signals import SIGNALS
from hd_control.pages.pages import PAGES
from hd_control.pages.pages import SIGNAL_MEANINGS as DESCRIBED

FOLDER = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_current(name: str) -> None:
    """python -m hd_control.pages"""
    assert (FOLDER / name).read_text(encoding="utf-8") == PAGES[name]()


def test_every_page_is_generated() -> None:
    found = {f"reference/{path.name}" for path in (FOLDER / "reference").glob("*.md")}
    assert found | {"faults.md"} == set(PAGES)


def test_every_signal_has_a_meaning() -> None:
    assert set(DESCRIBED) == set(SIGNALS)


def test_every_topic_and_parameter_of_the_nodes_has_a_meaning() -> None:
    rows = [line for line in (FOLDER / "reference" / "nodes.md").read_text().splitlines() if line.startswith("| `")]
    empty = [row for row in rows if row.count("|") > 3 and row.split("|")[-2].strip() == ""]
    assert len(rows) > 150 and not empty, empty
