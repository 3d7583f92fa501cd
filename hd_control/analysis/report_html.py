"""Pieces of a report page: escaped text, tables, lists, and the place of a figure with its data."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from hd_control.analysis.figures_style import Figure


class Figures:
    """The figures of one page: each gets a place in the text; the data go to the end of the page."""

    def __init__(self) -> None:
        self._data: list[str] = []

    def place(self, figure: Figure) -> str:
        """The place of a figure; it keeps its height before the figure is drawn, so that nothing jumps."""
        name = f"figure-{len(self._data) + 1}"
        self._data.append(f'<script type="application/json" id="{name}">{json_text(figure)}</script>')
        return f'<div class="figure" data-figure="{name}" style="height:{int(figure["layout"]["height"])}px"></div>'

    @property
    def data(self) -> str:
        """All figures' data as elements of the page."""
        return "\n".join(self._data)


def json_text(value: Any) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(_plain(value), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")


def _plain(value: Any) -> Any:
    """Numbers that JSON does not know (NaN, infinity) become null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    return value


def paragraph(text: str, style: str = "") -> str:
    """A paragraph of plain text; nothing if the text is empty."""
    kind = f' class="{style}"' if style else ""
    return f"<p{kind}>{escape(text)}</p>" if text else ""


def listed(items: Iterable[str], style: str = "") -> str:
    """A list of plain texts; nothing if it is empty."""
    kind = f' class="{style}"' if style else ""
    points = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ul{kind}>{points}</ul>" if points else ""


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: frozenset[int] = frozenset()) -> str:
    """A table of plain texts; columns in `numbers` are aligned right. It scrolls on its own on a narrow screen."""

    def cells(row: Sequence[str], tag: str) -> str:
        kinds = (' class="number"' if i in numbers else "" for i in range(len(row)))
        return "".join(f"<{tag}{kind}>{escape(text)}</{tag}>" for kind, text in zip(kinds, row, strict=True))

    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{cells(heads, "th")}</tr></thead><tbody>{body}</tbody></table></div>'


def grid(pieces: Iterable[str], style: str = "") -> str:
    """Pieces side by side where the screen is wide enough."""
    text = "".join(pieces)
    return f'<div class="grid{" " + style if style else ""}">{text}</div>' if text else ""


def card(*pieces: str, style: str = "") -> str:
    """A box; nothing if it would be empty."""
    text = "".join(pieces)
    return f'<div class="card{" " + style if style else ""}">{text}</div>' if text else ""


def folded(summary: str, *pieces: str) -> str:
    """What only some readers want, behind one line; nothing if it would be empty."""
    text = "".join(pieces)
    return f"<details><summary>{escape(summary)}</summary>{text}</details>" if text else ""


def number(value: float | None, digits: int = 3) -> str:
    """A number with its significant digits; a dash where there is none."""
    if value is None or value != value:
        return "–"
    return f"{value:.{digits}g}"
