"""A few words of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def cell(text: str) -> str:
    """Text for a table: one line, no bar that would end the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table; a table without rows has none."""
    lines = ["| " + " | ".join(cell(text) for text in row) + " |" for row in rows]
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *lines] if lines else []


def code(text: str) -> str:
    """Text in the form of code; an empty text stays empty."""
    return f"`{text}`" if text else ""


def page(title: str, source: str, *blocks: Sequence[str]) -> str:
    """A page with the sentence that says how it is made; blocks are separated by an empty line."""
    made = f"Made from {source} by `python -m hd_control.reference`; a test fails when it is not current."
    parts = [[f"# {title}"], [made], *(block for block in blocks if block)]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"
