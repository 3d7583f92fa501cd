"""One self-contained page of a recording and its models: verdict first, then pictures, then tables. Works offline."""

from __future__ import annotations

import os
import tempfile
from html import escape
from pathlib import Path

from hd_control.analysis.condition_maps import LEAST_EFFECTIVE, UNITS, ChannelMaps
from hd_control.analysis.figures_ladder import confidence_figure, horizon_figure, ladder_figure
from hd_control.analysis.figures_maps import heat_figure, largest_rms, map_figure
from hd_control.analysis.figures_orders import order_figure
from hd_control.analysis.figures_overlay import overlay_figure
from hd_control.analysis.figures_style import CHANNELS, Figure, shown_unit
from hd_control.analysis.map_sentence import concentration, sentence
from hd_control.analysis.order_lines import describe
from hd_control.analysis.report_assets import POLICY, SCRIPT, STYLE
from hd_control.analysis.report_data import ChannelPage, JointPage, ParameterRow, ReportPage
from hd_control.analysis.report_html import Figures, card, folded, grid, listed, number, paragraph, table
from hd_control.analysis.verdict_words import BADGES, confidence_bars, headline, plain_name, reasons
from hd_control.core.errors import HdError

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
    partial = ""
    try:
        handle, partial = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(report_html(page))
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(partial, 0o666 & ~mask)
        os.replace(partial, path)
    except OSError as error:
        if partial:
            Path(partial).unlink(missing_ok=True)
        raise HdError(f"{path}: cannot write the report ({error.strerror})") from None
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
