"""What all pictures share: a figure as plain data of plotly.js (`data`, `layout`), colours, axes, packed numbers.

A figure is a dictionary, so it costs nothing to build and goes into pages, tests and `plotly.graph_objects.Figure`
alike. Long series are thinned with their extremes kept; rows that do not count are gaps. `write_page` makes a page of
Plotly figures alone.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.core.files import write_whole

# ---- A page of Plotly figures ----------------------------------------------------------------------


POINTS = 2000
"""Points of a drawn series; a screen is narrower."""
COLOURS = ("#1b6ca8", "#d1495b", "#2e8b57", "#e08e0b", "#6a4c93", "#17becf", "#8b5a2b", "#555555")


def thinned(series: FloatArray, points: int = POINTS) -> NDArray[np.intp]:
    """Indices of at most about `points` samples of `series` (k,) that keep every local extreme of a bin."""
    if series.size <= points:
        return np.arange(series.size)
    from tsdownsample import MinMaxDownsampler

    sampler: Any = MinMaxDownsampler
    keep = sampler().downsample(np.ascontiguousarray(series), n_out=points - points % 2)
    return np.asarray(keep, dtype=np.intp)


def write_page(figure: Any, path: Path) -> Path:
    """One self-contained HTML page, no network needed. Raises HdError if it cannot be written."""
    write_whole(path, figure.to_html(include_plotlyjs=True, full_html=True, config={"displaylogo": False}))
    return path


# ---- A figure as plain data ------------------------------------------------------------------------


Figure = dict[str, Any]
"""`{"data": [...], "layout": {...}}`"""

MEASURED, FLOOR, GRID, INK = "#3d4451", "#8a93a3", "#e6e9ee", "#1f2430"
FORWARD_COLOUR, BACKWARD_COLOUR, REST_COLOUR = COLOURS[0], COLOURS[1], FLOOR
WARN = COLOURS[3]
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
CHANNELS = {"motor_torque": "motor side", "transmission": "transmission", "link_torque": "link side"}
"""Channels in words."""


def packed(values: Any) -> Any:
    """Numbers as plotly.js reads them compactly: single precision, base64."""
    array = np.ascontiguousarray(values, dtype="<f4")
    spec: dict[str, Any] = {"dtype": "f4", "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    if array.ndim > 1:
        spec["shape"] = ", ".join(str(n) for n in array.shape)
    return spec


def kept(values: FloatArray, used: BoolArray) -> NDArray[np.intp]:
    """Indices of a thinned series with the ends of its gaps, so that no line is drawn across one."""
    keep = thinned(np.where(used, values, 0.0))
    ends = np.flatnonzero(np.diff(used.astype(np.int8)))
    if ends.size > keep.size:
        return keep
    return np.unique(np.concatenate([keep, ends, ends + 1])).astype(np.intp)


def with_gaps(values: FloatArray, used: BoolArray) -> FloatArray:
    """The series with NaN where it is not used."""
    return np.where(used, values, np.nan)


def line(x: FloatArray, y: FloatArray, name: str, colour: str, **more: Any) -> dict[str, Any]:
    """A line trace; further keys replace its own."""
    stroke = {"color": colour, "width": more.pop("width", 1.3), "dash": more.pop("dash", "solid")}
    trace = {"type": "scatter", "mode": "lines", "x": packed(x), "y": packed(y), "name": name, "line": stroke}
    return {**trace, **more}


def axis(title: str, **more: Any) -> dict[str, Any]:
    """One axis of the house style."""
    own = {"gridcolor": GRID, "zerolinecolor": "#c4cad4", "automargin": True, "exponentformat": "power"}
    return {"title": {"text": title, "standoff": 8}, **own, **more}


def layout(title: str, height: int, **more: Any) -> dict[str, Any]:
    """Layout of the house style: title above, legend of up to two rows below the title."""
    left = {"x": 0.0, "xanchor": "left"}
    return {
        "title": {
            "text": title,
            "xref": "container",
            "font": {"size": 14},
            "pad": {"l": 8, "t": 10},
            **left,
            "yref": "container",
            "y": 1.0,
            "yanchor": "top",
        },
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "height": height,
        "margin": {"l": 56, "r": 14, "t": 82, "b": 44},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "font": {"size": 11}, **left},
        "hoverlabel": {"font": {"family": FONT}},
        **more,
    }


def note(text: str, x: float | str, y: float | str, **more: Any) -> dict[str, Any]:
    """A small text inside the picture, in its own coordinates unless `more` says otherwise."""
    own = {"showarrow": False, "font": {"size": 11, "color": MEASURED}, "align": "left"}
    return {"text": text, "x": x, "y": y, **own, **more}
