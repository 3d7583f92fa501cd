"""Figures of Hashimoto's paper from our runs: sensor (4, 12-14) and torque control (15-17)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_control.reproduce import hashimoto_sensor as sensor
from hd_control.reproduce.gandhi_figures import Titled, line, sheet
from hd_control.reproduce.hashimoto_runs import Motion, TorqueExperiment, TorqueRun, Variant, run

VARIANTS: dict[Variant, str] = {
    "open": "motor alone",
    "paper": "law (19)",
    "improved": "(19), integral, friction fed forward",
}


def _runs(motion: Motion, seed: int) -> dict[str, TorqueRun]:
    return {name: run(TorqueExperiment(motion, variant, noise_seed=seed)) for variant, name in VARIANTS.items()}


def modulation() -> Titled:
    """Fig. 4: the reading over a turn of the wave generator without torque."""
    degrees, nothing = np.rad2deg(sensor.ANGLES), np.zeros_like(sensor.ANGLES)
    titles = ["one gauge pair and two pairs", "two pairs, second one 2 degrees off; fourth harmonic"]
    figure = sheet(titles, ["% of rated torque"] * 2, "gauge angle β in deg")
    exact, off = sensor.bridge(), sensor.bridge(misalignment=math.radians(2.0))
    fourth = sensor.bridge(fourth_modulation=sensor.constants()["fourth_modulation"])
    scale = 100.0 / (sensor.gain(exact) * sensor.constants()["rated_torque"])
    line(figure, degrees, 2.0 * scale * exact.one_pair(nothing, sensor.ANGLES), "one pair", 1)
    line(figure, degrees, scale * exact.output(nothing, sensor.ANGLES), "two pairs", 0)
    line(figure, degrees, scale * off.output(nothing, sensor.ANGLES), "2° off", 3, 2)
    line(figure, degrees, scale * fourth.output(nothing, sensor.ANGLES), "fourth harmonic", 4, 2)
    return "Figs. 4, 5: modulation by the wave generator and its cancellation", figure


def linearity() -> Titled:
    """Fig. 12: output over torque at rest, up and down."""
    most, own = sensor.constants()["rated_torque"], sensor.bridge(rated=False)
    torque = np.concatenate((np.linspace(-most, most, 100), np.linspace(most, -most, 100)))
    output = own.output(torque, np.zeros_like(torque)) * sensor.constants()["amplifier_gain"]
    figure = sheet(["sensor output behind the amplifier"], ["V"], "torque in N m")
    line(figure, torque, output, "sensor", 0)
    return "Fig. 12: linearity", figure


def sensor_in_motion() -> Titled:
    """Figs. 13 and 14: sensor beside the true torque."""
    titles = ["motor pulse on the locked link", "step of the joint angle", "sensor minus true torque"]
    figure = sheet(titles, ["N m"] * 3)
    for row, series in enumerate((sensor.pulse(), sensor.moving_joint(math.radians(2.0))), 1):
        line(figure, series["time"], series["true"], "true torque", 7, row, showlegend=row == 1)
        line(figure, series["time"], series["sensor"], "sensor, 2° off", 0, row, showlegend=row == 1,
             line={"dash": "dot"})  # fmt: skip
        name = ("pulse", "moving joint")[row - 1]
        line(figure, series["time"], series["sensor"] - series["true"], f"difference, {name}", row, 3)
    return "Figs. 13, 14: sensor in motion", figure


def static_loops(seed: int) -> Titled:
    """Fig. 15: joint torque over required torque, slow sine; below the error."""
    figure = sheet(["static loop", "joint torque minus required torque"], ["N m", "N m"], "required torque in N m")
    for colour, (name, one) in enumerate(_runs("static", seed).items()):
        last = slice(-len(one.time) // sensor.constants()["static_cycles"], None)
        thin = slice(None, None, 20)
        required, torque = one.required[last][thin], one.torque[last][thin]
        for row, values in ((1, torque), (2, torque - required)):
            style: Any = {"color": sheet_colour(colour), "width": 1.4}
            figure.add_scatter(x=required, y=values, name=name, line=style, row=row, col=1, showlegend=row == 1)
    return "Fig. 15: static characteristic", figure


def sheet_colour(number: int) -> str:
    """The colour of a series by its number."""
    from hd_control.analysis.figures import COLOURS

    return COLOURS[number % len(COLOURS)]


def steps(seed: int) -> Titled:
    """Fig. 16: the step of the required torque."""
    figure = sheet(["joint torque"], ["N m"], "time after the step in ms")
    found = _runs("step", seed)
    for colour, (name, one) in enumerate(found.items()):
        shown = (one.time >= 0.09) & (one.time < 0.25)
        line(figure, 1e3 * (one.time[shown] - 0.1), one.torque[shown], name, colour)
    line(figure, 1e3 * (one.time[shown] - 0.1), one.required[shown], "required", 7, line={"dash": "dash"})
    return "Fig. 16: step response", figure


def waves(seed: int) -> Titled:
    """Fig. 17: 5 N m at 20 Hz."""
    figure = sheet(["joint torque"], ["N m"], "time in ms")
    for colour, (name, one) in enumerate(_runs("wave", seed).items()):
        shown = (one.time >= 1.0) & (one.time < 1.15)
        line(figure, 1e3 * (one.time[shown] - 1.0), one.torque[shown], name, colour)
    line(figure, 1e3 * (one.time[shown] - 1.0), one.required[shown], "required", 7, line={"dash": "dash"})
    return "Fig. 17: 20 Hz", figure
