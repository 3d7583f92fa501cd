"""The one picture of a story: the model's error falls, the same goal is tracked better, and what the seal said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.files import write_whole
from hd_control.demo.outcome import Outcome, verdicts
from hd_control.lab.page.model_figures import Rung, ladder_figure
from hd_control.lab.page.page import Figures, card, html_page, listed, paragraph
from hd_control.lab.page.pictures import find_browser, write_figures
from hd_control.lab.page.style import FLOOR, FORWARD_COLOUR, Figure, axis, layout, line, thinned
from hd_control.lab.signals.tracking import Tracking

HEIGHT = 620
MEANING = (
    "A robot on live nodes hides an effect. Its recording shows where the model fails, the diagnosis names what is "
    "missing, and with it in the controllers the same goal is tracked again."
)
NAME = "demo"


def story_figure(outcome: Outcome) -> Figure:
    """Ladder of the first suspect (left), its tracking before and after (right), all joints below."""
    before = outcome.tracking["goal_before"]
    after = outcome.tracking.get("goal_after")
    joint = outcome.suspects[0] if outcome.suspects else before.joint_names[0]
    figure: Figure = {"data": [], "layout": layout(_title(outcome), HEIGHT)}
    figure["layout"]["title"] |= {"y": 0.965, "yref": "container", "yanchor": "top"}
    figure["layout"]["margin"] = {"l": 20, "r": 20, "t": 104, "b": 60}
    figure["layout"]["legend"] = {"orientation": "h", "x": 0.5, "y": -0.07, "xanchor": "center", "yanchor": "top"}
    notes: list[dict[str, Any]] = []
    _ladder(figure, notes, outcome, joint)
    _curves(figure, notes, joint, before, after)
    _joints(figure, notes, before, after)
    figure["layout"]["annotations"] = notes
    return figure


def _title(outcome: Outcome) -> str:
    """Hidden and diagnosed in two lines."""
    hidden = ", ".join(f"{h['name'].replace('_', ' ')} on {h['joint']}" for h in outcome.hidden) or "still sealed"
    named = ", ".join(f"{d['name'].replace('_', ' ')} on {d['joint']}" for d in outcome.diagnosed) or "nothing"
    return f"Diagnosed: <b>{named}</b><br>Hidden, opened last: <b>{hidden}</b>"


def _head(text: str, x: float, y: float) -> dict[str, Any]:
    font = {"size": 13}
    place = {"xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom", "showarrow": False}
    return {"text": text, "x": x, "y": y, "font": font, **place}


def _ladder(figure: Figure, notes: list[dict[str, Any]], outcome: Outcome, joint: str) -> None:
    """The held-out error of each rung."""
    found = outcome.ladder.get("joints", {}).get(joint)
    if found is None:
        notes.append(_head("No effect was added to the model", 0.0, 1.02))
        return
    one = ladder_figure([Rung.of(rung) for rung in found["rungs"]], found["unit"])
    for trace in one["data"]:
        figure["data"].append({**trace, "xaxis": "x", "yaxis": "y"})
    figure["layout"]["xaxis"] = {**one["layout"]["xaxis"], "domain": [0.0, 0.42], "anchor": "y"}
    figure["layout"]["yaxis"] = {**one["layout"]["yaxis"], "domain": [0.0, 1.0], "anchor": "x"}
    notes.append(_head(f"Model error of {joint} on a run not used for the fit", 0.0, 1.02))


def _curves(figure: Figure, notes: list[dict[str, Any]], joint: str, before: Tracking, after: Tracking | None) -> None:
    """Position error of one joint over the goal."""
    for name, found, colour in (("before", before, FLOOR), ("after", after, FORWARD_COLOUR)):
        if found is None:
            continue
        error = 1e6 * found.error[:, found.joint_names.index(joint)]
        time = (found.stamps_ns - found.stamps_ns[:1].sum()) * 1e-9
        keep = thinned(error)
        words = {"xaxis": "x2", "yaxis": "y2", "legendgroup": name}
        figure["data"].append(line(time[keep], error[keep], f"{name}: old model" if name == "before" else
                                   f"{name}: new model", colour, **words))  # fmt: skip
    figure["layout"]["xaxis2"] = axis("time in the goal, s", domain=[0.53, 1.0], anchor="y2")
    figure["layout"]["yaxis2"] = axis("µrad", domain=[0.56, 1.0], anchor="x2")
    notes.append(_head(f"Position error of {joint}, the same goal", 0.53, 1.02))


def _joints(figure: Figure, notes: list[dict[str, Any]], before: Tracking, after: Tracking | None) -> None:
    """RMS of all joints."""
    for name, found, colour in (("before", before, FLOOR), ("after", after, FORWARD_COLOUR)):
        if found is None:
            continue
        values = [1e6 * value for value in found.rms().values()]
        figure["data"].append({
            "type": "bar", "x": [n.replace("joint_", "joint ") for n in found.joint_names], "y": values, "name": name,
            "marker": {"color": colour}, "xaxis": "x3", "yaxis": "y3", "legendgroup": name, "showlegend": False,
            "text": [f"{v:.0f}" for v in values], "textposition": "outside", "cliponaxis": False,
            "hovertemplate": "%{x}: %{y:.3g} µrad",
        })  # fmt: skip
    top = max(float(np.max(1e6 * np.array(list(t.rms().values())))) for t in (before, after) if t is not None)
    figure["layout"]["xaxis3"] = axis("", domain=[0.53, 1.0], anchor="y3", type="category")
    figure["layout"]["yaxis3"] = axis("RMS, µrad", domain=[0.0, 0.36], anchor="x3", range=[0.0, 1.18 * top])
    notes.append(_head("Tracking error of all joints", 0.53, 0.38))


def write_page(path: Path, outcome: Outcome, figure: Figure, lines: list[str]) -> None:
    """The page of the story: picture, what it means, the table and the commands. Raises HdError."""
    figures = Figures()
    place = figures.place(figure)
    said = [*verdicts(outcome), "The seal was opened after the diagnosis was written; nothing read it before."]
    body = card(place, listed(said), "<h3>The table</h3>", f"<pre>{_escaped(lines)}</pre>")
    head = paragraph(MEANING, "meta")
    write_whole(path, html_page("hd demo", head, "", body, figures))


def _escaped(lines: list[str]) -> str:
    from html import escape

    return escape("\n".join(lines))


def write_png(folder: Path, figure: Figure) -> Path | None:
    """The picture as PNG by an installed browser; None if there is none."""
    if find_browser() is None:
        return None
    return write_figures(folder, {NAME: figure}, force=True)[0]
