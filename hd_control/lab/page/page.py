"""One self-contained page of a recording and its models: verdict first, then pictures, then tables. Works offline.

Nothing is fetched: style and script stand in the page, and its own rules forbid any connection.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from hd_control.core.errors import HdError
from hd_control.core.files import write_whole
from hd_control.lab.balances.channels import shown_unit
from hd_control.lab.maps.condition_maps import LEAST_EFFECTIVE, UNITS, ChannelMaps, concentration, sentence
from hd_control.lab.maps.orders import describe
from hd_control.lab.models.observations import Observations, sections
from hd_control.lab.page.measured_figures import density_figure, friction_figure, friction_group_figure
from hd_control.lab.page.model_figures import confidence_figure, horizon_figure, ladder_figure, overlay_figure
from hd_control.lab.page.page_data import ChannelPage, JointPage, ParameterRow, ReportPage
from hd_control.lab.page.residual_figures import heat_figure, largest_rms, map_figure, order_figure
from hd_control.lab.page.style import CHANNELS, Figure
from hd_control.lab.page.words import BADGES, confidence_bars, headline, plain_name, reasons

# ---- Style and script ------------------------------------------------------------------------------


POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""Content security policy: what is in the page, and nothing else."""

STYLE = """
:root { --ink: #1f2430; --soft: #5b6472; --line: #dfe3e9; --paper: #ffffff; --back: #f4f6f8; --accent: #1b6ca8; }
* { box-sizing: border-box; }
html { scroll-behavior: smooth; scroll-padding-top: 3.2rem; }
body { margin: 0; background: var(--back); color: var(--ink); line-height: 1.5;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; font-size: 16px; }
main, header.top > div { max-width: 1180px; margin: 0 auto; padding: 0 20px; }
header.top { background: var(--paper); border-bottom: 1px solid var(--line); padding: 26px 0 16px; }
h1 { font-size: 1.55rem; margin: 0 0 .3rem; } h2 { font-size: 1.3rem; margin: 0; }
h3 { font-size: 1.05rem; margin: 0 0 .2rem; } h4 { font-size: .95rem; margin: 1.2rem 0 .4rem; }
p { margin: .4rem 0; } code { font-size: .86em; overflow-wrap: anywhere; }
.meta { color: var(--soft); font-size: .9rem; overflow-wrap: anywhere; }
nav { position: sticky; top: 0; z-index: 5; background: rgba(255,255,255,.96); border-bottom: 1px solid var(--line);
  overflow-x: auto; white-space: nowrap; }
nav > div { max-width: 1180px; margin: 0 auto; padding: 8px 20px; display: flex; gap: 8px; }
nav a { color: var(--ink); text-decoration: none; font-size: .88rem; padding: 3px 10px; border-radius: 999px;
  border: 1px solid var(--line); background: var(--paper); }
nav a:hover { border-color: var(--accent); }
.dot { display: inline-block; width: .62em; height: .62em; border-radius: 50%; margin-right: .4em;
  background: #8a93a3; }
.adequate .dot { background: #2e8b57; } .missing .dot, .missing_and_unknown .dot { background: #1b6ca8; }
.unknown .dot { background: #e08e0b; }
.cannot_tell .dot { background: #8a93a3; }
section.joint { margin: 26px 0 40px; }
.card { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: 18px 20px;
  margin: 14px 0; }
.verdict { border-left: 5px solid #8a93a3; }
.verdict.adequate { border-left-color: #2e8b57; }
.verdict.missing, .verdict.missing_and_unknown { border-left-color: #1b6ca8; }
.verdict.unknown { border-left-color: #e08e0b; }
.verdict .say { font-size: 1.12rem; font-weight: 600; margin: .2rem 0 .5rem; }
.badge { color: var(--soft); font-size: .82rem; text-transform: uppercase; letter-spacing: .05em; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 330px), 1fr)); gap: 14px; }
.grid.wide { grid-template-columns: repeat(auto-fit, minmax(min(100%, 430px), 1fr)); }
.figure { min-width: 0; width: 100%; }
.figure .modebar { opacity: 0 !important; } .figure:hover .modebar { opacity: .9 !important; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
.scroll { overflow-x: auto; } th { text-align: left; color: var(--soft); font-weight: 600; }
th, td { padding: 5px 12px 5px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
details { margin-top: 10px; } summary { cursor: pointer; color: var(--accent); font-size: .92rem; }
ul { margin: .3rem 0; padding-left: 1.15rem; } li { margin: .2rem 0; }
.finding { font-weight: 500; } .small { font-size: .88rem; color: var(--soft); }
@media (max-width: 600px) { main, header.top > div, nav > div { padding-left: 12px; padding-right: 12px; }
  .card { padding: 14px 12px; border-radius: 8px; } body { font-size: 15px; } h1 { font-size: 1.3rem; } }
@media print { nav { display: none; } body { background: white; } .card { break-inside: avoid; border: 0; } }
"""

SCRIPT = """
"use strict";
(() => {
  const coarse = matchMedia("(pointer: coarse)").matches;
  const root = document.documentElement;
  root.dataset.drawn = "0";
  const draw = (place) => {
    if (place.dataset.state) return;
    place.dataset.state = "drawing";
    const figure = JSON.parse(document.getElementById(place.dataset.figure).textContent);
    if (coarse) figure.layout.dragmode = false;
    const bar = coarse ? false : "hover";
    Plotly.newPlot(place, figure.data, figure.layout, { responsive: true, displaylogo: false, displayModeBar: bar })
      .then(() => { place.dataset.state = "drawn"; root.dataset.drawn = String(Number(root.dataset.drawn) + 1); });
  };
  const places = document.querySelectorAll(".figure");
  const watch = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { watch.unobserve(entry.target); draw(entry.target); }
  }, { rootMargin: "800px 0px" });
  for (const place of places) watch.observe(place);
  const all = () => {
    for (const box of document.querySelectorAll("details")) box.open = true;
    places.forEach(draw);
  };
  addEventListener("beforeprint", all);
  if (location.hash === "#all") all();
})();
"""
"""A picture is drawn when it comes near the screen; `#all` behind the address draws everything at once."""


# ---- Pieces: escaped text, tables, lists, the place of a figure with its data ----------------------


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


# ---- The page --------------------------------------------------------------------------------------


SHOWN_MAPS = 3
"""Condition maps that are open; the rest is folded."""
CROSSES = (
    f"A cross marks fewer than {LEAST_EFFECTIVE:g} independent samples; where nothing was recorded, nothing is drawn."
)


def write_report(path: str | Path, page: ReportPage, force: bool = False) -> Path:
    """Writes the page, whole or not at all. Raises HdError if the file exists and `force` is not given, or cannot be
    written."""
    path = Path(path)
    if path.exists() and not force:
        raise HdError(f"{path}: exists already; choose another name or add --force")
    write_whole(path, report_html(page))
    return path


def report_html(page: ReportPage) -> str:
    """The text of the page."""
    figures = Figures()
    joints = "".join(_joint(joint, i, figures) for i, joint in enumerate(page.joints))
    links = "".join(
        f'<a class="{_verdict(joint)}" href="#joint-{i}"><span class="dot"></span>{escape(joint.joint)}</a>'
        for i, joint in enumerate(page.joints)
    )
    head = paragraph(f"Recording: {page.bag}", "meta") + paragraph(f"Models: {', '.join(page.models)}", "meta")
    head += paragraph(page.command, "meta") + listed(page.notes, "small")
    return html_page(
        page.title, head, f"<nav><div>{links}</div></nav>" if len(page.joints) > 1 else "", joints, figures
    )


def html_page(title: str, head: str, navigation: str, body: str, figures: Figures) -> str:
    """A whole page around its pieces (all of them escaped already, but for the title)."""
    from plotly.offline import get_plotlyjs

    name = escape(title)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<link rel="icon" href="data:,">
<title>{name}</title>
<style>{STYLE}</style>
</head>
<body>
<header class="top"><div><h1>{name}</h1>{head}</div></header>
{navigation}
<main>
{body}
</main>
{figures.data}
<script>{get_plotlyjs()}</script>
<script>{SCRIPT}</script>
</body>
</html>
"""


def _verdict(joint: JointPage) -> str:
    return joint.diagnosis.verdict if joint.diagnosis is not None else ""


def _joint(joint: JointPage, place: int, figures: Figures) -> str:
    pieces = [f"<h2>{escape(joint.joint)}</h2>", _answer(joint, figures)]
    ladders = (figures.place(ladder_figure(x.rungs, x.unit, x.stopped_because)) for x in joint.ladders if x.rungs)
    pieces.append(card(grid(ladders, "wide")))
    pieces.append(_measured(joint.observations, figures))
    pieces += [_channel(channel, figures) for channel in joint.channels]
    if joint.horizons:
        curves = (figures.place(horizon_figure(c, title)) for title, c in joint.horizons.items())
        pieces.append(card("<h3>Free run: how long does the model predict the motion?</h3>", grid(curves, "wide")))
    pieces.append(_parameters(joint.parameters))
    pieces.append(card(folded("Notes on this joint", listed(joint.notes))) if joint.notes else "")
    return f'<section class="joint" id="joint-{place}">{"".join(pieces)}</section>\n'


def _answer(joint: JointPage, figures: Figures) -> str:
    """Verdict, reasons, confidence, and what to record next."""
    found = joint.diagnosis
    if found is None:
        return ""
    bars = confidence_bars(found)
    experiments = [f"{e.purpose}: {e.how}" for e in found.experiments]
    return card(
        f'<div class="badge">{escape(BADGES[found.verdict])}</div>',
        paragraph(headline(found), "say"),
        listed(reasons(found)),
        figures.place(confidence_figure(bars)) if bars else "",
        f"<h4>What to record next</h4>{listed(experiments)}" if experiments else "",
        folded("What limits this recording", listed(found.notes)),
        style=f"verdict {found.verdict}",
    )


MEASURED = (
    "Sensors, delays, friction and lines as they were measured. No model of friction and no guessed inertia stands in "
    "them, so they hold also where the recording cannot say what is missing in a model."
)


def _measured(found: Observations | None, figures: Figures) -> str:
    """What the recording shows before any model is asked."""
    if found is None:
        return ""
    parts = dict(sections(found))
    curves = [
        figures.place(figure)
        for curve in found.friction
        for figure in (
            friction_figure(curve),
            *(friction_group_figure(curve, name) for name in dict.fromkeys(g.variable for g in curve.groups)),
        )
    ]
    pieces = [f"<h3>What was measured</h3>{paragraph(MEASURED, 'small')}"]
    for head in ("sensors", "delays"):
        pieces.append(f"<h4>{head.capitalize()}</h4>{listed(parts[head])}" if head in parts else "")
    if curves:
        pieces.append(f"<h4>Friction</h4>{grid(curves, 'wide')}{listed(parts['friction'], 'small')}")
    spectra = (
        figures.place(figure)
        for x in found.spectra
        for figure in (
            order_figure(x.orders, x.lines, x.unit, f"Order spectrum of the {x.signal.replace('_', ' ')} itself"),
            density_figure(x),
        )
    )
    lines = folded("All lines in words", listed(parts["lines"])) if "lines" in parts else ""
    pieces.append(f"<h4>Spectra of the measured signals</h4>{grid(spectra, 'wide')}{lines}" if found.spectra else "")
    return card(*pieces)


def _channel(channel: ChannelPage, figures: Figures) -> str:
    first = next(iter(channel.models))
    maps = channel.maps[first]
    unit = channel.models[first].unit
    name = CHANNELS[channel.name]
    zooms = (figures.place(overlay_figure(channel.models, window, 330)) for window in channel.windows)
    shown, rest = _ordered(maps)
    curves = [figures.place(f) for f in _map_figures(channel, shown, unit)]
    more = [figures.place(f) for f in _map_figures(channel, rest, unit)]
    heats = [figures.place(figure) for figure in _heat_figures(channel, unit)]
    return card(
        f"<h3>{escape(name[0].upper() + name[1:])}</h3>",
        paragraph(sentence(maps, channel.models[first].noise_floor), "finding"),
        _numbers(channel),
        figures.place(overlay_figure(channel.models)),
        grid(zooms),
        "<h4>Where the error is</h4>",
        paragraph(CROSSES, "small"),
        grid([*heats, *curves], "wide"),
        folded("More conditions", grid(more, "wide")),
        "<h4>Cycles per turn</h4>",
        _orders(channel, unit, figures),
    )


def _ordered(maps: ChannelMaps) -> tuple[list[str], list[str]]:
    """Variables of the maps: those that say most first."""
    where = concentration(maps)
    lead = where.variable if where is not None else ""
    names = sorted(
        maps.maps, key=lambda name: (name != lead, -round(maps.maps[name].explained, 2), list(UNITS).index(name))
    )
    return names[:SHOWN_MAPS], names[SHOWN_MAPS:]


def _map_figures(channel: ChannelPage, names: list[str], unit: str) -> list[Figure]:
    return [map_figure({m: maps.maps[v] for m, maps in channel.maps.items() if v in maps.maps}, unit) for v in names]


def _heat_figures(channel: ChannelPage, unit: str) -> list[Figure]:
    """One for each model, all with the same colours."""
    found = {model: maps.speed_load for model, maps in channel.maps.items() if maps.speed_load is not None}
    top = max((largest_rms(item) for item in found.values()), default=0.0)
    return [heat_figure(item, unit, model if len(found) > 1 else "", top) for model, item in found.items()]


def _orders(channel: ChannelPage, unit: str, figures: Figures) -> str:
    pieces = []
    factor, shown = shown_unit(unit)
    for model, (spectrum, lines) in channel.spectra.items():
        title = "Order spectrum of the error" + (f", {model}" if len(channel.spectra) > 1 else "")
        pieces.append(figures.place(order_figure(spectrum, lines, unit, title)))
        pieces.append(listed(describe(item, spectrum, shown, factor) for item in lines))
    return "".join(pieces)


def _numbers(channel: ChannelPage) -> str:
    """Errors of all models in the unit of the pictures."""
    factor, unit = shown_unit(next(iter(channel.models.values())).unit)
    rows = []
    for model, c in channel.models.items():
        percent = 100.0 * c.rms_error / c.rms_measured if c.rms_measured > 0.0 else float("nan")
        values = (c.rms_error, c.rms_error_refitted, c.noise_floor)
        numbers = [number(factor * value) for value in values]
        rows.append(
            [
                model,
                numbers[0],
                f"{number(percent)} %",
                numbers[1],
                numbers[2],
                f"{100.0 * c.structured_fraction:.0f} %",
            ]
        )
    heads = [f"model (errors RMS, {unit})", "error", "of measured", "after refitting", "noise floor", "not noise"]
    return table(heads, rows, frozenset(range(1, 6)))


def _parameters(rows: tuple[ParameterRow, ...]) -> str:
    if not rows:
        return ""
    heads = ["effect", "parameter", "value", "95 % interval", "unit", "bound", "source", "remark"]
    body = []
    for row in rows:
        interval = "–" if row.low is None or row.high is None else f"{number(row.low)} … {number(row.high)}"
        cells = [plain_name(row.effect), plain_name(row.name), number(row.value, 4), interval, row.unit, row.bound]
        body.append([*cells, row.source, row.remark])
    return card("<h3>Parameters</h3>", table(heads, body, frozenset({2, 3})))
