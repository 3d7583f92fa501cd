"""The curves of `hd bench --growth` as one picture: a field for each axis, both logarithmic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hd_control.analysis.figures import COLOURS
from hd_control.analysis.figures_style import Figure, axis, layout

FIELDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("joints", ("decode_message", "replay_tick", "compare_arm_20s")),
    ("messages", ("read_topic",)),
    ("s of recording", ("compare_joint", "diagnose_joint")),
    ("Hz", ("compare_minute", "diagnose_minute", "ring_missed", "ring_p50")),
)
"""Axis -> curves that are drawn over it."""


def growth_figure(points: Sequence[Mapping[str, Any]]) -> Figure:
    """Each curve over its smallest value, so that a slope can be read: 1 on the vertical axis is the first point."""
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    measured = {point["name"] for point in points}
    fields = [(title, names) for title, names in FIELDS if measured & set(names)]
    for number, (title, names) in enumerate(fields, 1):
        suffix = "" if number == 1 else str(number)
        left = (number - 1) / len(fields) + (0.03 if number > 1 else 0.0)
        more[f"xaxis{suffix}"] = axis(title, type="log", domain=[left, number / len(fields) - 0.03], dtick="D2")
        more[f"yaxis{suffix}"] = axis("times the first value" if number == 1 else "", type="log", anchor=f"x{suffix}")
        for name in names:
            data += _curve(
                [point for point in points if point["name"] == name], suffix, COLOURS[len(data) % len(COLOURS)]
            )
    return {"data": data, "layout": layout("What more joints, longer and faster recordings cost", 460, **more)}


def _curve(points: Sequence[Mapping[str, Any]], suffix: str, colour: str) -> list[dict[str, Any]]:
    points = [point for point in points if point["value"] is not None and math.isfinite(point["value"])]
    if not points or not points[0]["value"]:
        return []
    first = points[0]
    return [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": [point["size"] for point in points],
            "y": [point["value"] / first["value"] for point in points],
            "name": f"{first['name']} ({first['value']:.3g} {first['unit']})",
            "xaxis": f"x{suffix}",
            "yaxis": f"y{suffix}",
            "line": {"color": colour},
        }
    ]
