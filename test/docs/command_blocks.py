"""The commands of the documents: blocks of shell code with a word that says how far a test may go with them.

    ```sh            runs in every test; a comment `# exit code N` at the end of a line says what is expected, else 0
    ```sh slow       seconds to minutes: only `./hd test --long DOCS` runs it
    ```sh live       needs a running robot or runs until it is stopped: checked word by word
    ```sh install    changes the computer: checked as far as it names our own commands and files
    ```sh parse      examples without their files: checked word by word

Blocks of one page run one after the other in one folder. A block inside a comment, `<!-- sh` to `-->`, runs unseen.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("", "slow", "live", "install", "parse")
START = re.compile(r"^(?:```sh ?(\w*)|<!-- sh)$")
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


def pages() -> list[Path]:
    """Every document of the project that people read."""
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("bags/*.md")])


def commands(page: Path) -> list[Command]:
    """The command lines of a page in order; a line that ends with a backslash goes on."""
    return list(_read(str(page.relative_to(ROOT)), page.read_text(encoding="utf-8").splitlines()))


def _read(page: str, lines: list[str]) -> Iterator[Command]:
    kind, held, inside = "", "", False
    for number, line in enumerate(lines, 1):
        if not inside:
            if found := START.match(line):
                kind, inside, held = found[1] or "", True, ""
                assert kind in KINDS, f"{page}:{number}: unknown word {kind!r} after sh"
        elif line in ("```", "-->"):
            inside = False
        elif line.endswith("\\"):
            held += line[:-1]
        elif (held + line).split("#")[0].strip():
            text, held = held + line.strip(), ""
            expected = EXPECTED.search(text)
            yield Command(page, number, kind, text, int(expected[1]) if expected else 0)


def inline_commands(page: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every `hd …` between back-ticks in the running text."""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        for text in re.findall(r"`((?:\./)?hd [a-z][^`]*)`", line):
            yield number, text
