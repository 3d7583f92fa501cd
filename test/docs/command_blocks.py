"""The commands of the documents: blocks of shell code with a word that says how far a test may go with them.

    ```sh            runs in every test; a comment `# exit code N` at the end of a line says what is expected, else 0
    ```sh slow       seconds to minutes: only `./hd test --long DOCS` runs it
    ```sh live       needs a running robot or runs until it is stopped: checked word by word
    ```sh install    changes the computer: checked as far as it names our own commands and files
    ```sh parse      examples without their files: checked word by word
    ```yaml NAME     a file that the reader writes; so does the test (any language)

Blocks of one page act one after the other in one folder. A block in a comment, `<!-- sh` or `<!-- yaml NAME` to `-->`,
acts unseen.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("", "slow", "live", "install", "parse")
START = re.compile(r"^(?:```|<!-- )(\w+)(?: (\S+))?$")
EXPECTED = re.compile(r"#.*\bexit code (\d+)")


@dataclass(frozen=True)
class Command:
    """One command line of a page; `kind` is one of KINDS, `code` the exit code that is expected."""

    page: str
    line: int
    kind: str
    text: str
    code: int = 0

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


@dataclass(frozen=True)
class Written:
    """A file of a page, by name."""

    name: str
    text: str


def pages() -> list[Path]:
    """Every document of the project that people read."""
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("bags/*.md")])


def steps(page: Path) -> list[Command | Written]:
    """What a reader does, in order."""
    name, found = str(page.relative_to(ROOT)), list[Command | Written]()
    for number, language, word, lines in blocks(page):
        if language == "sh":
            assert word in KINDS, f"{name}:{number}: unknown word {word!r} after sh"
            found += _commands(name, number, word, lines)
        elif word:
            found.append(Written(word, "\n".join(lines) + "\n"))
    return found


def commands(page: Path) -> list[Command]:
    """The command lines of a page."""
    return [step for step in steps(page) if isinstance(step, Command)]


def blocks(page: Path) -> Iterator[tuple[int, str, str, list[str]]]:
    """Line, language, word and lines of every block of code, seen or unseen."""
    start: tuple[int, str, str] | None = None
    lines: list[str] = []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if start is None:
            found = START.match(line)
            if found or line.startswith("```"):
                start, lines = (number, found[1] if found else "", (found[2] or "") if found else ""), []
        elif line in ("```", "-->"):
            yield (*start, lines)
            start = None
        else:
            lines.append(line)


def _commands(page: str, start: int, kind: str, lines: list[str]) -> Iterator[Command]:
    """A line that ends with a backslash goes on in the next."""
    held = ""
    for number, line in enumerate(lines, start + 1):
        text, held = held + line.strip(), ""
        if text.endswith("\\"):
            held = text[:-1]
        elif text.split("#")[0].strip():
            expected = EXPECTED.search(text)
            yield Command(page, number, kind, text, int(expected[1]) if expected else 0)


def inline_commands(page: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every `hd …` between back-ticks in the running text."""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        for text in re.findall(r"`((?:\./)?hd [a-z][^`]*)`", line):
            yield number, text
