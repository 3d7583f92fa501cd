"""Relative links lead to files and headings that exist, and every page can be reached from the index."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_blocks import ROOT, Written, pages, steps

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


PACKAGES = ("hd_control", "hd_sim", "test")


def known_files() -> set[str]:
    """Every file of the packages and the tests, and those of the root that a page may name."""
    places = [*ROOT.glob("*.py"), *(path for name in PACKAGES for path in (ROOT / name).rglob("*"))]
    return {str(path.relative_to(ROOT)) for path in places}


def missing_files(text: str, known: set[str]) -> list[str]:
    """Folders and files that a page names between back-ticks and that are not there; of a short name the end counts."""
    folders = re.findall(r"`((?:hd_control|hd_sim|test|config|launch|requirements)/[\w/.-]+)`", text)
    sources = re.findall(r"`([a-z0-9_/]+\.(?:py|hpp|cpp))`", text)
    return [name for name in folders if not (ROOT / name).exists()] + [
        name for name in sources if not any(f"/{path}".endswith(f"/{name}") for path in known)
    ]


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_files_named_in_the_text_exist(page: Path) -> None:
    if page.name == "CHANGELOG.md":
        return  # history: a file may be gone
    written = {step.name for step in steps(page) if isinstance(step, Written)}
    assert not missing_files(page.read_text(encoding="utf-8"), known_files() | written)


def test_a_missing_file_is_seen() -> None:
    known = {"hd_control/laws/motion.py"}
    text = "`hd_control/laws/motion.py`, `motion.py`, `laws/motion.py`, `otion.py`, `hd_sim/nowhere`"
    assert missing_files(text, known) == ["hd_sim/nowhere", "otion.py"]


def test_files_named_in_the_code_exist() -> None:
    """In docstrings and comments; files of other projects stand with their package, as `rclpy/...`."""
    known, count, wrong = known_files(), 0, []
    for path in sorted(path for name in PACKAGES[:2] for path in (ROOT / name).rglob("*.[hcp]*")):
        if path.suffix not in (".py", ".hpp", ".cpp"):
            continue
        for name in re.findall(r"(?<![\w*./{-])(?!rclpy/)[a-z][a-z0-9_/]*\.(?:py|hpp|cpp)\b", path.read_text("utf-8")):
            count += 1
            if not any(f"/{file}".endswith(f"/{name}") for file in known):
                wrong.append(f"{path.relative_to(ROOT)}: {name}")
    assert count > 30 and not wrong, wrong
