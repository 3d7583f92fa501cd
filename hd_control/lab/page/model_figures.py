"""Pictures of models beside data: error ladder, confidence, free run, overlay of one balance, replayed outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.balances.channels import shown_unit
from hd_control.lab.maps.zoom import Window
from hd_control.lab.models.compare import ChannelComparison
from hd_control.lab.models.ladder import REFIT
from hd_control.lab.page.style import (
    CHANNELS,
    COLOURS,
    FLOOR,
    FORWARD_COLOUR,
    INK,
    MEASURED,
    WARN,
    Figure,
    axis,
    kept,
    layout,
    line,
    note,
    thinned,
    with_gaps,
)
from hd_control.lab.signals.tracking import Tracking

BAR = COLOURS[0]
UNCHANGED = {REFIT: "only_refitted"}
"""Rungs that add no effect, as they are shown."""


@dataclass(frozen=True)
class Rung:
    """One step of the ladder, as in `hd.ladder/1`: errors RMS in the unit of the channel; `effect` of the first rung
    is the model as it was given."""

    effect: str
    parameters_count: int
    error_train: float
    error_held_out: float
    noise_floor: float

    @classmethod
    def of(cls, rung: Mapping[str, Any]) -> Rung:
        """From the JSON form; further keys do not matter."""
        names = ("error_train", "error_held_out", "noise_floor")
        return cls(str(rung["effect"]), int(rung["parameters_count"]), *(_number(rung[name]) for name in names))


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def ladder_figure(rungs: Sequence[Rung], unit: str, stopped_because: str = "", height: int = 380) -> Figure:
    """Held-out error of each rung and its percentage of the first; training error as a thin mark; noise floor."""
    factor, shown = shown_unit(unit)
    names = [_broken(UNCHANGED.get(rung.effect, rung.effect)) for rung in rungs]
    held_out = [factor * rung.error_held_out for rung in rungs]
    base = held_out[0] if held_out and held_out[0] > 0.0 else 1.0
    text = [f"{value:.3g} ({percent_of(value / base)})" for value in held_out]
    colours = [FLOOR if k == 0 or rung.effect in UNCHANGED else BAR for k, rung in enumerate(rungs)]
    bars = {
        "type": "bar", "x": names, "y": held_out, "text": text, "textposition": "auto", "textangle": 0,
        "insidetextanchor": "middle", "insidetextfont": {"color": "white"}, "cliponaxis": False,
        "marker": {"color": colours}, "name": "held-out data", "width": 0.62, "hovertemplate": "%{x}: %{y:.4g}",
    }  # fmt: skip
    mark = {"symbol": "line-ew", "size": 34, "line": {"width": 2.0, "color": INK}}
    train = {
        "type": "scatter", "mode": "markers", "x": names, "y": [factor * rung.error_train for rung in rungs],
        "marker": mark, "name": "training data", "hovertemplate": "training: %{y:.4g}",
    }  # fmt: skip
    floor = [factor * rung.noise_floor for rung in rungs]
    level = {
        "type": "scatter", "mode": "lines", "x": names, "y": floor, "name": "noise floor",
        "line": {"color": WARN, "width": 1.8, "dash": "dash"}, "hovertemplate": "noise floor: %{y:.4g}",
    }  # fmt: skip
    result = layout("Error on data that were not used for the fit", height)
    result["xaxis"] = axis(f"stopped: {stopped_because}" if stopped_because else "", type="category")
    result["yaxis"] = axis(f"RMS error, {shown}", range=[0.0, 1.18 * max([*held_out, 1e-12])])
    return {"data": [bars, level, train], "layout": result}


def percent_of(ratio: float) -> str:
    """In per cent, with two digits where it is small."""
    return f"{100.0 * ratio:.0f} %" if not ratio < 0.0995 else f"{100.0 * ratio:.2g} %"


def _broken(name: str) -> str:
    """An effect's name on lines of its own words, so that narrow screens can show it."""
    return name.replace("_", "<br>") if len(name) > 12 else name


@dataclass(frozen=True)
class Bar:
    """One candidate: probability in [0, 1], or None where the verdict alone says it (unknown, cannot tell). `note` is
    printed beside it: the runner-up and its share of the gain, or what the unknown depends on."""

    name: str
    probability: float | None
    note: str = ""


def percent(probability: float) -> str:
    """A probability in words; never a certainty."""
    return "> 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"


def confidence_figure(bars: Sequence[Bar], height: int = 0) -> Figure:
    """One horizontal bar for each candidate; what has no probability is hatched."""
    names = [bar.name.replace("_", " ") for bar in bars]
    values = [100.0 if bar.probability is None else 100.0 * bar.probability for bar in bars]
    plain = [bar.probability is not None for bar in bars]
    words = ["" if bar.probability is None else percent(bar.probability) for bar in bars]
    trace = {
        "type": "bar", "orientation": "h", "x": values, "y": names, "text": words, "textposition": "inside",
        "insidetextanchor": "start", "width": 0.36, "hovertemplate": "%{y}: %{x:.0f} %<extra></extra>",
        "marker": {
            "color": [BAR if known else "#dfe3e9" for known in plain],
            "pattern": {"shape": ["" if known else "/" for known in plain], "fgcolor": FLOOR, "size": 6},
        },
    }  # fmt: skip
    notes = [
        note(bar.note.replace(", ", ",<br>"), 0.0, name, xanchor="left", yanchor="top", yshift=-15)
        for bar, name in zip(bars, names, strict=True)
        if bar.note
    ]
    result = layout("How sure is each answer", height or 96 + 76 * max(1, len(bars)), annotations=notes)
    result["margin"] = {"l": 10, "r": 14, "t": 44, "b": 40}
    result["xaxis"] = axis("probability, %", range=[0.0, 100.0])
    result["yaxis"] = axis("", type="category", autorange=False, range=[len(bars) - 0.25, -0.35])
    result["showlegend"] = False
    return {"data": [trace], "layout": result}


@dataclass(frozen=True)
class HorizonCurve:
    """Free-run error over the time since the start: `horizon` s and `error` RMS (k,), `unit` of the error; `baseline`
    marks a curve to compare with, such as holding the last value."""

    name: str
    horizon: FloatArray
    error: FloatArray
    unit: str
    baseline: bool = False


def horizon_figure(curves: Sequence[HorizonCurve], title: str, height: int = 340) -> Figure:
    """Error of a free run over its horizon, both axes logarithmic; baselines are grey and dashed."""
    factor, shown = shown_unit(curves[0].unit) if curves else (1.0, "")
    traces = []
    for i, curve in enumerate(curves):
        colour, dash = (FLOOR, "dash") if curve.baseline else (COLOURS[i % len(COLOURS)], "solid")
        positive = (curve.horizon > 0.0) & (curve.error > 0.0) & np.isfinite(curve.error)
        traces.append(line(curve.horizon[positive], factor * curve.error[positive], curve.name, colour, dash=dash))
    result = layout(title, height, hovermode="x")
    result["xaxis"] = axis("time since the start of the free run, s", type="log")
    result["yaxis"] = axis(f"RMS error, {shown}", type="log")
    return {"data": traces, "layout": result}


# ---- A balance: measurement and models with the residual below, whole or in one window -------------


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


# ---- A replay: the joint that differs most beside what was recorded, and every difference ----------


UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


def replay_figure(
    title: str, unit: str, time: FloatArray, recorded: FloatArray, made: FloatArray, joint_names: Sequence[str]
) -> Figure:
    """`time` (k,) s; `recorded` and `made` (k, n) in `unit`, NaN where there is nothing."""
    difference = made - recorded
    size = np.where(np.isfinite(difference), np.abs(difference), 0.0).max(axis=0, initial=0.0)
    worst = int(np.argmax(size))
    traces = []
    for name, values, colour in (("recorded", recorded, MEASURED), ("replayed", made, FORWARD_COLOUR)):
        own = values[:, worst]
        keep = kept(own, np.isfinite(own))
        dash = "solid" if name == "recorded" else "dot"
        traces.append(line(time[keep], own[keep], f"{joint_names[worst]} {name}", colour, dash=dash))
    for joint, name in enumerate(joint_names):
        if size[joint] > 0.0:
            there = np.isfinite(difference[:, joint])
            keep = kept(np.where(there, difference[:, joint], 0.0), there)
            shown = with_gaps(difference[:, joint], there)[keep]
            traces.append(line(time[keep], shown, name, COLOURS[joint % len(COLOURS)], yaxis="y2", width=1.0))
    result = layout(title, 460)
    result["xaxis"] = axis("time, s", anchor="y2")
    result["yaxis"] = axis(unit, domain=[0.56, 1.0])
    result["yaxis2"] = axis(f"replayed - recorded, {unit}", domain=[0.0, 0.44])
    return {"data": traces, "layout": result}


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
