"""Pictures of recordings: Plotly figures, built once here, shown in pages. Long series are thinned, extremes kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.analysis.tracking import Tracking
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import HdError

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


def tracking_figure(tracking: Tracking, title: str) -> Any:
    """Motion of every joint from its start, and its position error below, over time."""
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.09, row_heights=[0.42, 0.58],
        subplot_titles=("desired motion from the start", "joint position error: reference minus joint sensor"),
    )  # fmt: skip
    stamps = tracking.stamps_ns
    time = (stamps - stamps[:1].sum()) * 1e-9
    for joint, name in enumerate(tracking.joint_names):
        line = {"color": COLOURS[joint % len(COLOURS)], "width": 1.2}
        motion = np.rad2deg(tracking.reference[:, joint] - tracking.reference[:1, joint].sum())
        for row, values in ((1, motion), (2, tracking.error[:, joint] * 1e3)):
            keep = thinned(values)
            legend = {"name": name, "legendgroup": name, "showlegend": row == 2}
            figure.add_scatter(x=time[keep], y=values[keep], line=line, row=row, col=1, **legend)
    figure.update_yaxes(title_text="degrees", row=1, col=1)
    figure.update_yaxes(title_text="mrad", row=2, col=1)
    figure.update_xaxes(title_text="time in s", row=2, col=1)
    margin = {"l": 70, "r": 20, "t": 80, "b": 50}
    figure.update_layout(title=title, template="plotly_white", height=640, margin=margin, hovermode="x unified")
    return figure


def write_page(figure: Any, path: Path) -> Path:
    """One self-contained HTML page, no network needed. Raises HdError if it cannot be written."""
    try:
        figure.write_html(path, include_plotlyjs=True, full_html=True, config={"displaylogo": False})
    except OSError as error:
        raise HdError(f"{path}: cannot write the picture ({error.strerror})") from None
    return path
