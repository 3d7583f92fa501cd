"""Figs. 4 to 6 of Gandhi and Ghorbel from our runs, and two more: the terms of the law, the control period."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_control.analysis.figures import COLOURS, thinned
from hd_control.core.arrays import FloatArray
from hd_control.reproduce.gandhi_runs import ABLATION, PERIODS, Experiment, run

Titled = tuple[str, Any]
COMPOSITE, PLAIN = "composite law (26)", "plain law (31)"


def sheet(rows: list[str], units: list[str], across: str = "time in s") -> Any:
    """An empty figure: one row for each subtitle, a shared axis across."""
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.1, subplot_titles=rows)
    for row, unit in enumerate(units, 1):
        figure.update_yaxes(title_text=unit, row=row, col=1)
    figure.update_xaxes(title_text=across, row=len(rows), col=1)
    margin = {"l": 80, "r": 20, "t": 80, "b": 50}
    figure.update_layout(template="plotly_white", height=250 * len(rows) + 100, margin=margin)
    return figure


def line(figure: Any, x: FloatArray, y: FloatArray, name: str, colour: int, row: int = 1, **more: Any) -> None:
    """One series, thinned to what a screen shows."""
    keep = thinned(np.ascontiguousarray(y))
    style = {"color": COLOURS[colour], "width": 1.4, **more.pop("line", {})}
    figure.add_scatter(x=x[keep], y=y[keep], name=name, line=style, row=row, col=1, mode="lines", **more)


def motion() -> Titled:
    """Fig. 4: the reference with the joint on it, and the load."""
    ours = run(Experiment())
    figure = sheet(["reference and joint position", "load torque"], ["deg", "N m"])
    line(figure, ours.time, np.rad2deg(ours.reference[:, 0]), "reference", 7)
    line(figure, ours.time, np.rad2deg(ours.measured[:, 0]), "joint", 0, line={"dash": "dash"})
    line(figure, ours.time, ours.reference[:, 5], "load", 3, 2)
    return "Fig. 4: trajectory and load", figure


def errors() -> Titled:
    """Fig. 5: error of joint and motor with and without compensation; below the error that remains, magnified."""
    ours, plain = run(Experiment()), run(Experiment("comparison"))
    titles = ["joint position error", "the same in the steady state, composite law", "motor position error / N"]
    figure = sheet(titles, ["deg", "1e-6 deg", "deg"])
    steady = ours.time >= 3.0
    for colour, (name, one) in enumerate(((COMPOSITE, ours), (PLAIN, plain))):
        line(figure, one.time, one.error_deg, name, colour)
        line(figure, one.time, one.motor_error_deg, name, colour, 3, showlegend=False)
    line(figure, ours.time[steady], 1e6 * ours.error_deg[steady], COMPOSITE, 0, 2, showlegend=False)
    return "Fig. 5: tracking errors", figure


def full_model() -> Titled:
    """Fig. 6: C-1, the plant the law was made for, and C-2, the plant with the polynomial spring."""
    runs = {"C-1 (linear spring)": run(Experiment()), "C-2 (polynomial spring)": run(Experiment(nonlinear=True))}
    figure = sheet(["joint position error", "the same in the steady state", "motor position error / N"], ["deg"] * 3)
    for colour, (name, one) in enumerate(runs.items()):
        steady = one.time >= 3.0
        line(figure, one.time, one.error_deg, name, colour)
        line(figure, one.time[steady], one.error_deg[steady], name, colour, 2, showlegend=False)
        line(figure, one.time, one.motor_error_deg, name, colour, 3, showlegend=False)
    return "Fig. 6: model of the law and full model", figure


def terms() -> Titled:
    """Steady-state error with the slow terms added one after the other."""
    import plotly.graph_objects as go

    values = [run(Experiment(composition)).largest_deg for composition in ("comparison", *ABLATION.values())]
    figure = go.Figure(go.Bar(x=["plain law (31)", "τ₀", "+ τ₁", "+ τ₂", "+ τ₄"], y=values, marker_color=COLOURS[0]))
    figure.update_yaxes(title_text="largest joint error, deg", type="log", exponentformat="power")
    figure.update_layout(template="plotly_white", height=380, margin={"l": 80, "r": 20, "t": 40, "b": 50})
    return "Terms of the composite law", figure


def _largest(prediction: float) -> list[float]:
    return [run(Experiment(prediction=prediction, period=period)).largest_deg for period in PERIODS.values()]


def periods() -> Titled:
    """Steady-state error over the control period, with and without half-sample prediction."""
    figure = sheet(["steady-state joint error over the control period"], ["largest error, deg"], "ms")
    across = 1e3 * np.array(list(PERIODS.values()))
    for colour, (name, prediction) in enumerate((("half-sample prediction", 0.5), ("no prediction", 0.0))):
        line(figure, across, np.array(_largest(prediction)), name, colour)
    figure.update_xaxes(type="log")
    figure.update_yaxes(type="log", exponentformat="power")
    return "Control period", figure
