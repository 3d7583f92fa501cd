"""The code cites equations that stand on the page it names; every number stands once and in the index.

An equation's number stands at the end of a line in a code block of its page, before the paper's number if it has one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import pytest
from command_blocks import ROOT

FOLDER = ROOT / "docs" / "equations"
BLOCK = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
DEFINED = re.compile(r"\(([A-Z]\d+)\)(?=$|[ ]+[ZGH][(,])", re.MULTILINE)
NUMBER = re.compile(r"\(([A-Z]\d+)\)")
CITED = re.compile(r"docs/equations/(\w+\.md)((?:(?:,|-| and)?\s*\([A-Z]\d+\))*)")
SOURCE = re.compile(r"\bSource: (.*?)(?=\n[ #/]*\n|\"\"\"|\Z)", re.DOTALL)
CODE = sorted(p for name in ("hd_control", "hd_sim", "test") for p in (ROOT / name).rglob("*.[chp]*") if p.is_file())
CODE = [path for path in CODE if path.suffix in (".py", ".hpp", ".cpp", ".pyi") and path != Path(__file__)]
EFFECTS = [p for p in sorted((ROOT / "hd_control" / "drive" / "effects").glob("*.py")) if p.stem != "__init__"]


def defined(text: str) -> list[str]:
    """Numbers of the equations that stand on a page, in order."""
    return [number for block in BLOCK.findall(text) for number in DEFINED.findall(block)]


def standing() -> dict[str, list[str]]:
    """Page name -> numbers of its equations."""
    return {page.name: defined(page.read_text(encoding="utf-8")) for page in sorted(FOLDER.glob("*.md"))}


def unmarked(text: str) -> str:
    """Text of a file with the marks of line comments taken off, so that a reference may run over two lines."""
    return re.sub(r"\n[ \t]*(?://|#)[ \t]*", "\n", text)


def broken(text: str, pages: Mapping[str, list[str]]) -> list[str]:
    """What is wrong with the references of a text; pages: name -> its numbers."""
    found = []
    for page, numbers in CITED.findall(unmarked(text)):
        if page not in pages:
            found.append(f"docs/equations/{page}: no such page")
            continue
        missing = [number for number in NUMBER.findall(numbers) if number not in pages[page]]
        found += [f"docs/equations/{page}: has no ({number})" for number in missing]
    return found


def sourceless(text: str) -> list[str]:
    """`Source:` lines that name no page with a number."""
    lines = SOURCE.findall(unmarked(text))
    return [f"Source: {line}" for line in lines if not any(NUMBER.search(ns) for _, ns in CITED.findall(line))]


def test_every_number_stands_once_and_has_its_pages_letter() -> None:
    pages = standing()
    often = [number for number, times in Counter(n for ns in pages.values() for n in ns).items() if times > 1]
    assert not often, often
    letters = {page: {number[0] for number in numbers} for page, numbers in pages.items() if page != "README.md"}
    assert all(len(found) == 1 for found in letters.values()), letters
    shared = [x for x, times in Counter(min(found) for found in letters.values()).items() if times > 1]
    assert not shared and not {"Z", "G", "H"} & {min(found) for found in letters.values()}, "letters of the papers"


def test_numbers_of_a_page_run_from_one() -> None:
    gaps = {page: ns for page, ns in standing().items() if sorted(int(n[1:]) for n in ns) != [*range(1, len(ns) + 1)]}
    assert not gaps


def test_the_index_lists_exactly_what_stands() -> None:
    rows = re.findall(r"^\| \[.+?\]\((\w+\.md)\) \| (.*) \|$", (FOLDER / "README.md").read_text(), re.MULTILINE)
    listed = {page: NUMBER.findall(text) for page, text in rows}
    stands = {page: sorted(ns, key=lambda n: int(n[1:])) for page, ns in standing().items() if page != "README.md"}
    assert listed == stands


def test_pages_refer_to_numbers_that_stand() -> None:
    """Every number in the text of the pages, and on the page that its link names."""
    pages = standing()
    known, wrong = {n for ns in pages.values() for n in ns}, []
    for page in sorted(FOLDER.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        wrong += [f"{page.name}: ({n})" for n in NUMBER.findall(text) if n not in known]
        for label, target in re.findall(r"\[([^\]]*)\]\((\w+\.md)", text):
            wrong += [f"{page.name}: {label}: {target}" for n in NUMBER.findall(label) if n not in pages[target]]
    assert not wrong, wrong


@pytest.mark.parametrize("path", EFFECTS, ids=lambda path: path.stem)
def test_every_effect_cites_an_equation(path: Path) -> None:
    doc = re.match(r'"""(.*?)"""', path.read_text(encoding="utf-8"), re.DOTALL)
    text = doc[1] if doc else ""
    assert SOURCE.search(text) and not sourceless(text), "no equation cited"


def test_code_cites_equations_that_stand() -> None:
    pages, cited, wrong = standing(), 0, []
    for path in CODE:
        text = path.read_text(encoding="utf-8")
        cited += len(CITED.findall(text))
        shipped = path.relative_to(ROOT).parts[0] != "test"
        found = (*broken(text, pages), *(sourceless(text) if shipped else ()))
        wrong += [f"{path.relative_to(ROOT)}: {what}" for what in found]
    assert cited > len(EFFECTS) and not wrong, wrong


def test_documents_cite_pages_that_stand() -> None:
    files = [*(ROOT / "config").rglob("*.yaml"), *(ROOT / "docs").rglob("*.md")]
    pages = standing()
    wrong = [f"{p.relative_to(ROOT)}: {what}" for p in files for what in broken(p.read_text(encoding="utf-8"), pages)]
    assert not wrong, wrong


def test_the_checker_can_fail() -> None:
    page = "Text (F9).\n\n```\nF = 1 by (T1) of x      (F1)\nG = 2    (F2)  Z(3)\nh by (F2)     q\n```\n"
    assert defined(page) == ["F1", "F2"]
    pages = {"friction.md": ["F1", "F2"]}
    assert broken("Source: docs/equations/friction.md (F1), (F2), Z(3). Valid.", pages) == []
    assert broken("docs/equations/friction.md (F1),\n    # (F3)", pages) == ["docs/equations/friction.md: has no (F3)"]
    assert broken("see docs/equations/gone.md", pages) == ["docs/equations/gone.md: no such page"]
    assert sourceless('"""Source: equation sheet 1.2, Z(3)."""') and sourceless("// Source: Z(3)\n\nint x;")
    assert not sourceless('"""Source: docs/equations/friction.md (F1), Z(3)."""') and sourceless("Source: measured.")
