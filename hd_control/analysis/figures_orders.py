"""Order spectrum as a picture: both directions, their floors, and the lines with their names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hd_control.analysis.figures_style import (
    BACKWARD_COLOUR,
    FLOOR,
    FORWARD_COLOUR,
    INK,
    Figure,
    axis,
    layout,
    line,
    note,
    packed,
    shown_unit,
)
from hd_control.analysis.order_lines import HERTZ, OrderLine
from hd_control.analysis.orders import BACKWARD, FORWARD, LINE_FACTOR, OrderSpectrum

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
