"""Overlay of measurement and models with the residual below, whole or in one window."""

from __future__ import annotations

from collections.abc import Mapping

from hd_control.analysis.compare import ChannelComparison
from hd_control.analysis.figures import COLOURS
from hd_control.analysis.figures_style import (
    CHANNELS,
    FLOOR,
    MEASURED,
    Figure,
    axis,
    kept,
    layout,
    line,
    shown_unit,
    with_gaps,
)
from hd_control.analysis.zoom import Window

LEFT_SIDES = {
    "motor_torque": "inertia torque of the motor",
    "transmission": "joint angle minus motor angle",
    "link_torque": "inertia torque of the link",
}
"""What stands on the left of a channel's balance, in words."""


def overlay_figure(models: Mapping[str, ChannelComparison], window: Window | None = None, height: int = 460) -> Figure:
    """Measured left side and what the models (name -> channel) say of it; below, residuals with the band +-2 sigma."""
    first = next(iter(models.values()))
    factor, unit = shown_unit(first.unit)
    rows = slice(0, first.time.size) if window is None else window.rows(first.time)
    traces = []
    time, used = first.time[rows], first.used[rows]
    centre = float(first.measured[first.used].mean()) if first.name == "transmission" and first.used.any() else 0.0
    measured = factor * (first.measured - centre)
    keep = kept(measured[rows], used)
    traces.append(line(time[keep], with_gaps(measured[rows], used)[keep], "measured", MEASURED, width=2.2))
    for i, (name, channel) in enumerate(models.items()):
        rows = slice(0, channel.time.size) if window is None else window.rows(channel.time)
        time, used = channel.time[rows], channel.used[rows]
        residual = factor * channel.residual[rows]
        said = factor * (channel.measured[rows] - centre) - residual
        colour = COLOURS[i % len(COLOURS)]
        for y, place in ((said, ""), (residual, "2")):
            keep = kept(y, used)
            group = {"legendgroup": name, "showlegend": not place, "yaxis": f"y{place}"}
            traces.append(line(time[keep], with_gaps(y, used)[keep], name, colour, **group))
    band = 2.0 * factor * first.noise_floor
    title = f"{CHANNELS[first.name].capitalize()}: {LEFT_SIDES[first.name]}"
    if window is not None:
        title = window.title[0].upper() + window.title[1:]
    shown = layout(title, height)
    shown["xaxis"] = axis("time in s", anchor="y2", range=_range(first, window))
    shown["yaxis"] = axis(unit, domain=[0.44, 1.0])
    shown["yaxis2"] = axis(f"error, {unit}", domain=[0.0, 0.36])
    shown["shapes"] = [_band(band)]
    shown["hovermode"] = "x"
    return {"data": traces, "layout": shown}


def _range(channel: ChannelComparison, window: Window | None) -> list[float]:
    if window is not None:
        return [window.start, window.end]
    return [float(channel.time[0]), float(channel.time[-1])] if channel.time.size else [0.0, 1.0]


def _band(height: float) -> dict[str, object]:
    """The noise band of the residual."""
    return {
        "type": "rect", "xref": "paper", "yref": "y2", "x0": 0.0, "x1": 1.0, "y0": -height, "y1": height,
        "fillcolor": FLOOR, "opacity": 0.22, "line": {"width": 0}, "layer": "below",
    }  # fmt: skip
