"""What was gained and how sure it is: error ladder, confidence bars, free-run error over the horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.analysis.figures import COLOURS
from hd_control.analysis.figures_style import FLOOR, INK, WARN, Figure, axis, layout, line, note, shown_unit
from hd_control.analysis.ladder import REFIT
from hd_control.core.arrays import FloatArray

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
