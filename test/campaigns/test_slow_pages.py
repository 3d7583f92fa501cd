"""All commands of the documents that need no running robot, also those that take minutes."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_blocks import ROOT, commands, pages
from page_runs import run_page

GOALS = ("DOCS",)

PAGES = [page for page in pages() if any(command.kind == "slow" for command in commands(page))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_runs_to_its_end(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").mkdir()
    assert run_page(page, {"", "slow"}) > 0
