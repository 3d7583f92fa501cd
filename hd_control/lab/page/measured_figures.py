"""Pictures of what was measured, before any model is asked: friction curve, density over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hd_control.lab.balances.channels import shown_unit
from hd_control.lab.maps.friction_curve import FrictionCurve, FrictionPoint
from hd_control.lab.maps.signal_spectra import CLEAR, HertzLine, SignalSpectrum
from hd_control.lab.page.style import (
    BACKWARD_COLOUR,
    COLOURS,
    FLOOR,
    FORWARD_COLOUR,
    INK,
    Figure,
    axis,
    layout,
    line,
    note,
    packed,
)

BAND = 0.2
"""Opacity of an interval."""
NAMES = {"motor_torque": "motor torque", "gauge_torque": "gauge torque", "torsion": "torsion"}
FEW = 3
"""Points below which an interval is a bar."""
LABELS = 6
"""Lines over time that get a label."""


def friction_figure(curve: FrictionCurve, height: int = 380) -> Figure:
    """Friction over signed speed, both directions, with 95 % intervals."""
    traces: list[dict[str, Any]] = []
    for direction, colour, name in ((-1, BACKWARD_COLOUR, "backward"), (1, FORWARD_COLOUR, "forward")):
        traces += _branch(curve.of(direction), direction, name, colour)
    result = layout(f"Friction that the {NAMES[curve.signal]} shows, with 95 % intervals", height)
    result["xaxis"] = axis("speed, rad/s", zeroline=True)
    result["yaxis"] = axis("torque against the motion, signed, N m")
    return {"data": traces, "layout": result}


def friction_group_figure(curve: FrictionCurve, variable: str, height: int = 380) -> Figure:
    """Friction over speed, mean of both directions, by load or by temperature."""
    traces: list[dict[str, Any]] = []
    groups = [(group, points) for group, points in curve.groups.items() if group.variable == variable]
    for i, (group, points) in enumerate(groups):
        both = [point for point in points if point.direction == 0]
        name = f"{group.low:.3g} … {group.high:.3g} {group.unit}"
        traces += _branch(both, 1, name, COLOURS[i % len(COLOURS)])
    result = layout(f"Friction by {variable}, {NAMES[curve.signal]}, both directions", height)
    result["xaxis"] = axis("speed, rad/s", type="log")
    result["yaxis"] = axis("torque against the motion, N m")
    return {"data": traces, "layout": result}


def _branch(points: Sequence[FrictionPoint], sign: int, name: str, colour: str) -> list[dict[str, Any]]:
    """One line with its interval; `sign` turns it to the side of its direction."""
    if not points:
        return []
    speed, torque = (np.array([sign * getattr(p, x) for p in points]) for x in ("speed", "torque"))
    known = [p for p in points if np.isfinite(p.low)]
    traces = []
    if known:
        x = np.array([sign * p.speed for p in known])
        low, high = (np.array([sign * getattr(p, side) for p in known]) for side in ("low", "high"))
        outline = {"x": packed(np.concatenate([x, x[::-1]])), "y": packed(np.concatenate([low, high[::-1]]))}
        traces.append({
            "type": "scatter", "mode": "lines", "fill": "toself", **outline, "line": {"width": 0}, "opacity": BAND,
            "fillcolor": colour, "hoverinfo": "skip", "showlegend": False, "name": name, "legendgroup": name,
        })  # fmt: skip
    marker = {"size": 6, "color": colour}
    template = "%{y:.3g} N m at %{x:.3g} rad/s"
    own = line(speed, torque, name, colour, legendgroup=name, marker=marker, hovertemplate=template)
    if len(known) == len(points) < FEW:  # too few for a band
        sides = [np.array([abs(getattr(p, side) - p.torque) for p in points]) for side in ("low", "high")]
        up, down = sides[::-1] if sign > 0 else sides
        own["error_y"] = {"type": "data", "array": packed(up), "arrayminus": packed(down), "color": colour}
    return [*traces, {**own, "mode": "lines+markers"}]


def density_figure(spectrum: SignalSpectrum, height: int = 340) -> Figure:
    """Density of a measured signal over frequency, the floor at the height that makes a line, its lines."""
    factor, unit = shown_unit(spectrum.unit)
    level, floor = factor * np.sqrt(spectrum.density), factor * np.sqrt(CLEAR * spectrum.floor)
    traces = [
        line(spectrum.frequency, level, NAMES[spectrum.signal], FORWARD_COLOUR, hovertemplate="%{x:.3g} Hz: %{y:.3g}"),
        line(spectrum.frequency, floor, f"{CLEAR:g} x local floor, in power", FLOOR, dash="dot", hoverinfo="skip"),
    ]
    marks = [_label(x, spectrum, factor) for x in spectrum.hertz[:LABELS]]
    result = layout(f"Spectrum of the {NAMES[spectrum.signal]} over time", height, annotations=marks)
    result["xaxis"] = axis("frequency, Hz", type="log", dtick="D2")
    result["yaxis"] = axis(f"{unit}/√Hz", type="log")
    return {"data": traces, "layout": result}


def _label(item: HertzLine, spectrum: SignalSpectrum, factor: float) -> dict[str, Any]:
    text = f"{item.frequency:.3g} Hz" if item.order is None else f"order {item.order:.3g}"
    i = int(np.argmin(np.abs(spectrum.frequency - item.frequency)))
    y = float(np.log10(factor * np.sqrt(max(spectrum.density[i], 1e-300))))
    return note(text, float(np.log10(item.frequency)), y, yshift=14, font={"size": 11, "color": INK})
