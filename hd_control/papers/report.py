"""The report of `hd reproduce`: papers' figures and tables beside ours in one HTML page that needs no network."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hd_control.core.files import write_whole
from hd_control.papers.rows import CAVEAT, TITLES, Row, met_text, number, target_text

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; width: 100%; font-size: 13px } th { text-align: left; border-bottom: 2px solid #888 }
td { border-bottom: 1px solid #ddd; padding: .2rem .6rem .2rem 0; vertical-align: top } td.n { white-space: nowrap }
.yes { color: #1a7f37 } .NO { color: #c0202a; font-weight: 700 } code { font-size: 12px } li { font-size: 13px }
"""
HEAD = ("figure", "paper", "ours", "worst seed", "target", "met", "unit", "place", "conditions")


def write_report(
    rows: Sequence[Row], figures: Mapping[str, Sequence[tuple[str, Any]]], seed: int, path: Path
) -> Path:  # fmt: skip
    """Writes the page: for each paper its table, its pictures by title, its chosen constants. Raises HdError."""
    from plotly.offline import get_plotlyjs

    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>hd reproduce</title>',
        f"<style>{STYLE}</style><script>{get_plotlyjs()}</script></head><body>",
        f"<h1>The papers beside us</h1><p>{html.escape(CAVEAT)}</p>",
        f"<p>First noise seed: {seed}. {html.escape(summary(rows))}</p>",
    ]
    for paper in dict.fromkeys(row.paper for row in rows):
        parts += _section(paper, [row for row in rows if row.paper == paper], figures.get(paper, ()))
    write_whole(path, "\n".join([*parts, "</body></html>"]) + "\n")
    return path


def summary(rows: Sequence[Row]) -> str:
    """How many targets there are and how many are met, in one sentence."""
    answers = [row.met for row in rows if row.met is not None]
    missed = [row.id for row in rows if row.met is False]
    return f"{sum(answers)} of {len(answers)} targets met" + (f"; missed: {', '.join(missed)}." if missed else ".")


def _section(paper: str, rows: Sequence[Row], figures: Sequence[tuple[str, Any]]) -> Iterator[str]:
    yield f"<h2>{html.escape(TITLES.get(paper, paper))}</h2>"
    yield f"<table><tr>{''.join(f'<th>{name}</th>' for name in HEAD)}</tr>"
    yield from (_line(row) for row in rows)
    yield "</table>"
    for title, figure in figures:
        yield f"<h3>{html.escape(title)}</h3>"
        yield figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False})
    chosen = list(dict.fromkeys(name for row in rows for name in row.chosen))
    if chosen:
        yield "<h3>Chosen constants</h3><ul>"
        yield from (f"<li>{html.escape(name)}</li>" for name in chosen)
        yield "</ul>"


def _line(row: Row) -> str:
    worst = number(row.worst) if row.seeds is not None else ""
    cells = (number(row.paper_value), number(row.ours), worst, target_text(row))
    numbers = "".join(f'<td class="n">{html.escape(cell)}</td>' for cell in cells)
    met = met_text(row)
    rest = "".join(f"<td>{html.escape(cell)}</td>" for cell in (row.unit, row.equation, row.conditions))
    return f'<tr><td><code>{html.escape(row.id)}</code></td>{numbers}<td class="{met}">{met}</td>{rest}</tr>'
