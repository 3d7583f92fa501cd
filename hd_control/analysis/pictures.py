"""PNG files of the key figures of a report, all drawn in one run of an installed browser."""

from __future__ import annotations

import base64
import json
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from hd_control.analysis.browser import look
from hd_control.analysis.figures_ladder import confidence_figure, ladder_figure
from hd_control.analysis.figures_maps import map_figure
from hd_control.analysis.figures_orders import order_figure
from hd_control.analysis.figures_overlay import overlay_figure
from hd_control.analysis.figures_style import Figure
from hd_control.analysis.map_sentence import dependence
from hd_control.analysis.report_data import JointPage, ReportPage
from hd_control.analysis.report_html import json_text
from hd_control.analysis.verdict_words import confidence_bars
from hd_control.core.errors import HdError

WIDTH, SCALE = 900, 2
"""Pixels of a picture before scaling; the file has `SCALE` times as many."""
_DRAW = """
(async () => {
  for (const [name, figure] of Object.entries(FIGURES)) {
    const size = { format: "png", width: WIDTH, height: figure.layout.height, scale: SCALE };
    const place = document.createElement("pre");
    place.id = name;
    place.textContent = await Plotly.toImage(figure, size);
    document.body.append(place);
  }
})();
"""


def write_pictures(folder: str | Path, page: ReportPage, force: bool = False) -> list[Path]:
    """The key figures of all joints as FOLDER/JOINT_WHAT.png. Raises HdError without a browser, or if a file exists
    and `force` is not given."""
    figures = {f"{joint.joint}_{what}": figure for joint in page.joints for what, figure in key_figures(joint).items()}
    return write_figures(folder, figures, force)


def key_figures(joint: JointPage) -> dict[str, Figure]:
    """What a reader needs first, by name: answer, ladder; per channel overlay, the map that says most, orders."""
    found: dict[str, Figure] = {}
    bars = confidence_bars(joint.diagnosis) if joint.diagnosis is not None else []
    if bars:
        found["confidence"] = confidence_figure(bars)
    for i, ladder in enumerate(joint.ladders):
        name = "ladder" if len(joint.ladders) == 1 else f"ladder_{i + 1}"
        found[name] = ladder_figure(ladder.rungs, ladder.unit, ladder.stopped_because)
    for channel in joint.channels:
        first = next(iter(channel.models))
        unit = channel.models[first].unit
        found[f"{channel.name}_overlay"] = overlay_figure(channel.models)
        shown = dependence(channel.maps[first])
        if shown is not None:
            found[f"{channel.name}_map"] = map_figure({first: shown}, unit)
        spectrum, lines = channel.spectra[first]
        if lines:
            found[f"{channel.name}_orders"] = order_figure(spectrum, lines, unit)
    return found


def write_figures(folder: str | Path, figures: Mapping[str, Figure], force: bool = False) -> list[Path]:
    """Figures (name -> figure) as FOLDER/NAME.png."""
    from plotly.offline import get_plotlyjs

    folder = Path(folder)
    paths = {name: folder / f"{re.sub('[^A-Za-z0-9_.-]', '_', name)}.png" for name in figures}
    for path in paths.values():
        if path.exists() and not force:
            raise HdError(f"{path}: exists already; choose another folder or add --force")
    script = _DRAW.replace("WIDTH", str(WIDTH)).replace("SCALE", str(SCALE))
    script = script.replace("FIGURES", json_text(dict(figures)))
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "figures.html"
        file.write_text(
            f'<!DOCTYPE html><html><head><meta charset="utf-8"></head><body><script>{get_plotlyjs()}</script>'
            f"<script>{script}</script></body></html>",
            encoding="utf-8",
        )
        drawn = dict(re.findall(r'<pre id="([^"]*)">data:image/png;base64,([^<]*)</pre>', look(file).html))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in paths.items():
            if name not in drawn:
                raise HdError(f"{path}: the browser drew no picture of {json.dumps(name)}")
            path.write_bytes(base64.b64decode(drawn[name]))
    except OSError as error:
        raise HdError(f"{folder}: cannot write the pictures ({error.strerror})") from None
    return list(paths.values())
