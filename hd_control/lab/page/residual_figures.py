"""Pictures of a residual: condition maps split by direction, heat maps over speed and load, the order spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.balances.channels import shown_unit
from hd_control.lab.maps.condition_maps import DIRECTIONS, NAMES, SPEEDS, ConditionMap, SpeedLoadMap
from hd_control.lab.maps.orders import BACKWARD, FORWARD, HERTZ, LINE_FACTOR, OrderLine, OrderSpectrum
from hd_control.lab.page.style import (
    BACKWARD_COLOUR,
    FLOOR,
    FORWARD_COLOUR,
    INK,
    REST_COLOUR,
    Figure,
    axis,
    layout,
    line,
    note,
    packed,
)

WORDS = {-1: "backward", 0: "at rest", 1: "forward"}
DIRECTION_COLOURS = {-1: BACKWARD_COLOUR, 0: REST_COLOUR, 1: FORWARD_COLOUR}
SHOWN = {
    "joint_position": (180.0 / np.pi, "degrees"),
    "motor_shaft_position": (180.0 / np.pi, "degrees"),
    "reversal_time": (1e3, "ms"),
    "reversal_travel": (1e3, "mrad"),
    "temperature": (1.0, "degrees Celsius"),
}
"""Factor and unit of a variable's axis where they differ from SI."""
DASHES = ("solid", "dash", "dot", "dashdot")


def map_figure(maps: Mapping[str, ConditionMap], unit: str, height: int = 330) -> Figure:
    """Mean residual over one variable for each direction, the share of the error of each bin below.

    maps: model -> map of the same variable; models differ by their dash. Shares are those of the first model.
    """
    first = next(iter(maps.values()))
    factor, shown = shown_unit(unit)
    traces: list[dict[str, Any]] = []
    for i, (model, item) in enumerate(maps.items()):
        for k, direction in enumerate(DIRECTIONS):
            if item.bins.count[k].any():
                name = WORDS[direction] if len(maps) == 1 else f"{model}, {WORDS[direction]}"
                traces += _curve(item, k, factor, name, DIRECTION_COLOURS[direction], DASHES[i % len(DASHES)])
    for k, direction in enumerate(DIRECTIONS):
        if first.bins.count[k].any():
            traces.append(_shares(first, k, WORDS[direction], DIRECTION_COLOURS[direction]))
    text = f"Over {NAMES[first.variable]}"
    text += f" — its mean explains {100.0 * first.explained:.0f} % of the error" if first.explained > 0.05 else ""
    result = layout(text, height, barmode="stack", bargap=0.0)
    result["xaxis"] = _variable_axis(first, anchor="y2")
    result["yaxis"] = axis(f"mean error, {shown}", domain=[0.40, 1.0])
    result["yaxis2"] = axis("share, %", domain=[0.0, 0.30], rangemode="tozero")
    return {"data": traces, "layout": result}


def _logarithmic(variable: str) -> bool:
    return variable in SPEEDS or variable.startswith("reversal")


def _edges(item: ConditionMap) -> FloatArray:
    """Edges on the axis: in its unit, or the logarithm of that; a lowest edge of 0 then gives way to half the next."""
    factor, _ = SHOWN.get(item.variable, (1.0, ""))
    return _log_edges(factor * item.edges) if _logarithmic(item.variable) else factor * item.edges


def _log_edges(edges: FloatArray) -> FloatArray:
    low = edges[0] if edges[0] > 0.0 else 0.5 * edges[1]
    return np.asarray(np.log10(np.concatenate([[low], edges[1:]])))


def _centres(item: ConditionMap) -> FloatArray:
    edges = _edges(item)
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def _log_ticks(low: float, high: float) -> dict[str, Any]:
    """Ticks 1, 2, 5 of every decade (1 alone over more than two) on an axis of logarithms."""
    steps = (1.0, 2.0, 5.0) if high - low < 2.0 else (1.0,)
    values = [step * 10.0**p for p in range(int(np.floor(low)), int(np.ceil(high)) + 1) for step in steps]
    return {"tickvals": np.log10(values).tolist(), "ticktext": [f"{value:g}" for value in values]}


def _variable_axis(item: ConditionMap, **more: Any) -> dict[str, Any]:
    _, unit = SHOWN.get(item.variable, (1.0, item.unit))
    if item.variable == "direction":
        return axis("direction", tickvals=list(DIRECTIONS), ticktext=list(WORDS.values()), **more)
    edges = _edges(item)
    if _logarithmic(item.variable):
        more.update(_log_ticks(float(edges[0]), float(edges[-1])))
    return axis(f"{NAMES[item.variable]}, {unit}", range=[float(edges[0]), float(edges[-1])], **more)


def _curve(item: ConditionMap, k: int, factor: float, name: str, colour: str, dash: str) -> list[dict[str, Any]]:
    """The bins' means, with crosses where too few independent samples stand behind one."""
    x, b = _centres(item), item.bins
    mean, few = factor * b.mean[k], b.few[k]
    details = np.stack([factor * b.rms[k], 100.0 * b.share[k], b.count[k], b.effective[k]], axis=1)
    hover = (
        "%{y:.3g} mean<br>%{customdata[0]:.3g} RMS<br>%{customdata[1]:.1f} % of the error"
        "<br>%{customdata[2]:.0f} samples, %{customdata[3]:.0f} independent"
    )
    more = {"customdata": packed(details), "hovertemplate": hover, "legendgroup": name, "mode": "lines+markers"}
    traces = [line(x, mean, name, colour, dash=dash, width=1.6, marker={"size": 4}, **more)]
    if few.any():
        cross = {"symbol": "x-thin", "size": 8, "line": {"width": 1.2, "color": colour}}
        points = {"x": packed(x[few]), "y": packed(mean[few]), "marker": cross, "legendgroup": name}
        traces.append({"type": "scatter", "mode": "markers", "showlegend": False, "hoverinfo": "skip", "name": name,
                       **points})  # fmt: skip
    return traces


def _shares(item: ConditionMap, k: int, name: str, colour: str) -> dict[str, Any]:
    return {
        "type": "bar", "x": packed(_centres(item)), "y": packed(100.0 * item.bins.share[k]), "yaxis": "y2",
        "name": name, "width": packed(np.diff(_edges(item))), "marker": {"color": colour, "opacity": 0.55},
        "showlegend": False, "hovertemplate": "%{y:.1f} %",
    }  # fmt: skip


def heat_figure(item: SpeedLoadMap, unit: str, model: str = "", top: float = 0.0, height: int = 330) -> Figure:
    """RMS residual over speed and joint torque, backward and forward side by side; crosses: few independent samples.

    `top` of the colours in the unit of the channel, for pictures that are compared; 0: the largest of this map.
    """
    factor, shown = shown_unit(unit)
    x, y = _log_edges(item.speed_edges), item.load_edges
    top = factor * (top or largest_rms(item))
    traces: list[dict[str, Any]] = []
    for place, k in (("", 0), ("2", 2)):
        details = np.stack([factor * item.bins.mean[k], 100.0 * item.bins.share[k], item.bins.count[k]])
        traces.append({
            "type": "heatmap", "x": packed(x), "y": packed(y), "z": packed(factor * item.bins.rms[k].T),
            "customdata": packed(details.transpose(2, 1, 0)), "zmin": 0.0, "zmax": top, "colorscale": "Viridis",
            "xaxis": f"x{place}", "yaxis": f"y{place}", "showscale": place == "2", "hoverongaps": False,
            "colorbar": {"title": {"text": f"RMS<br>{shown}"}, "thickness": 10, "len": 1.0},
            "hovertemplate": "RMS %{z:.3g}<br>mean %{customdata[0]:.3g}<br>%{customdata[1]:.1f} % of the error<br>"
            "%{customdata[2]:.0f} samples<extra></extra>",
        })  # fmt: skip
        few = np.argwhere(item.bins.few[k])
        xs, ys = (0.5 * (edges[1:] + edges[:-1]) for edges in (x, y))
        cross = {"symbol": "x-thin", "size": 5, "opacity": 0.7, "line": {"width": 1.0, "color": "#ffffff"}}
        traces.append({"type": "scatter", "mode": "markers", "x": packed(xs[few[:, 0]]), "y": packed(ys[few[:, 1]]),
                       "marker": cross, "xaxis": f"x{place}", "yaxis": f"y{place}", "hoverinfo": "skip",
                       "showlegend": False})  # fmt: skip
    title = "RMS error over speed and load" + (f", {model}" if model else "")
    result = layout(title, height, margin={"l": 56, "r": 14, "t": 44, "b": 44})
    ticks = {**_log_ticks(float(x[0]), float(x[-1])), "showgrid": False}
    result["xaxis"] = axis("backward, rad/s", domain=[0.0, 0.47], **ticks)
    result["xaxis2"] = axis("forward, rad/s", domain=[0.53, 1.0], **ticks)
    result["yaxis"] = axis("joint torque, N m", showgrid=False)
    result["yaxis2"] = axis("", anchor="x2", matches="y", showticklabels=False, showgrid=False)
    return {"data": traces, "layout": result}


def largest_rms(item: SpeedLoadMap) -> float:
    """Largest RMS of a map's bins, unit of the channel; 0 if all are empty."""
    return float(np.max(item.bins.rms, initial=0.0, where=np.isfinite(item.bins.rms)))


# ---- Order spectrum: both directions, their floors, the lines with their names ---------------------


LABELS = 8
"""Lines that get a label in the picture; all are in the text below it."""
CONDITIONS = {BACKWARD: ("backward", BACKWARD_COLOUR), FORWARD: ("forward", FORWARD_COLOUR)}


def order_figure(
    spectrum: OrderSpectrum, lines: Sequence[OrderLine], unit: str, title: str = "Order spectrum of the error",
    height: int = 380,
) -> Figure:  # fmt: skip
    """Amplitude over orders, both axes logarithmic; the dashed floor is drawn at the height that names a line."""
    factor, shown = shown_unit(unit)
    traces: list[dict[str, Any]] = []
    for direction, (name, colour) in CONDITIONS.items():
        one = spectrum.directions[direction]
        more = {"legendgroup": name, "hovertemplate": "order %{x:.4g}: %{y:.3g} " + shown}
        traces.append(line(one.orders, factor * one.amplitude, name, colour, **more))
    floor = np.fmax(*(spectrum.directions[d].floor for d in (BACKWARD, FORWARD)))
    orders = spectrum.directions[FORWARD].orders
    name = f"{LINE_FACTOR:g} x local floor"
    traces.append(line(orders, LINE_FACTOR * factor * floor, name, FLOOR, dash="dot", hoverinfo="skip"))
    named = list(lines[:LABELS])
    marker = {"symbol": "circle-open", "size": 9, "color": INK, "line": {"width": 1.4}}
    traces.append({
        "type": "scatter", "mode": "markers", "name": "lines", "marker": marker, "hovertemplate": "%{text}",
        "x": packed([x.order for x in lines]), "y": packed([factor * x.amplitude for x in lines]),
        "text": ["<br>or ".join(x.names) or x.bound for x in lines],
    })  # fmt: skip
    result = layout(title, height, annotations=[_label(x, factor) for x in named])
    low, high = spectrum.range
    result["xaxis"] = axis(f"cycles per {spectrum.turn}", type="log", range=_decades(low, high), dtick="D2")
    result["yaxis"] = axis(f"amplitude, {shown}", type="log")
    if not orders.size:
        text = (
            "Too few turns at constant direction inside the band of the channel.<br>A slow move over many turns helps."
        )
        result["annotations"] = [note(text, 0.5, 0.5, xref="paper", yref="paper", align="center")]
    return {"data": traces, "layout": result}


def _decades(low: float, high: float) -> list[float]:
    return [float(np.log10(low)), float(np.log10(high))] if low > 0.0 else [0.0, 1.0]


def _label(item: OrderLine, factor: float) -> dict[str, Any]:
    text = f"{item.order:.3g}"
    if item.bound == HERTZ:
        text += " (hertz)"
    elif item.names and "joint turn" in item.names[0] and "(N" in item.names[0]:
        text = item.names[0].split(" = ")[0]
    x, y = float(np.log10(item.order)), float(np.log10(factor * item.amplitude))
    return note(text, x, y, yshift=14, font={"size": 11, "color": INK})
