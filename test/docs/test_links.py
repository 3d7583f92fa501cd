"""Relative links lead to files and headings that exist, and every page can be reached from the index."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_blocks import ROOT, pages

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def links(page: Path) -> list[str]:
    """Targets of all links of a page, code left out."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return LINK.findall(text)


def anchors(page: Path) -> set[str]:
    """The anchors of the headings of a page, as Markdown viewers make them."""
    heads = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for target in links(page):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        if not there.exists():
            broken.append(f"{target}: no such file")
        elif anchor and anchor not in anchors(there):
            broken.append(f"{target}: no such heading")
    assert not broken, broken


def test_the_index_leads_to_every_page() -> None:
    seen, todo = set(), [ROOT / "docs" / "README.md"]
    while todo:
        page = todo.pop()
        seen.add(page)
        found = ((page.parent / target.partition("#")[0]).resolve() for target in links(page) if ":" not in target)
        todo += [path for path in found if path.suffix == ".md" and path.is_file() and path not in seen]
    missing = {str(page.relative_to(ROOT)) for page in pages() if page not in seen}
    assert not missing, "nobody finds these pages"


def test_pictures_are_used() -> None:
    used = {(page.parent / target).resolve() for page in pages() for target in links(page)}
    unused = [path.name for path in (ROOT / "docs" / "pictures").iterdir() if path not in used]
    assert not unused, unused


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_files_named_in_the_text_exist(page: Path) -> None:
    named = re.findall(r"`((?:hd_control|hd_sim|test|config|launch|requirements)/[\w/.-]+)`", page.read_text())
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing, missing


def test_the_walks_through_the_code_name_what_is_there() -> None:
    rows = re.findall(
        r"^\| .+ \| `([\w/.]+)` \| `(\w+)` \|$", (ROOT / "docs" / "architecture.md").read_text(), re.MULTILINE
    )
    wrong = [f"{file}: {name}" for file, name in rows if not re.search(rf"\b{name}\b", (ROOT / file).read_text())]
    assert len(rows) == 29 and not wrong, wrong
