"""A small report of one joint with everything in it, made of numbers that are known, without a simulation."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from hd_control.lab.diagnosis.fit import Interval
from hd_control.lab.diagnosis.verdict import (
    MISSING,
    ChannelError,
    Experiment,
    JointDiagnosis,
    NamedEffect,
    Rival,
    Unknown,
)
from hd_control.lab.maps.condition_maps import Conditions, maps_of
from hd_control.lab.maps.orders import OrderRecord, lines_of, order_spectrum
from hd_control.lab.maps.zoom import zoom_windows
from hd_control.lab.models.compare import ChannelComparison
from hd_control.lab.page.model_figures import HorizonCurve, Rung
from hd_control.lab.page.page_data import ChannelPage, JointPage, Ladder, ReportPage, parameter_rows

ROWS, PERIOD, RATIO = 5000, 0.008, 100.0
NOISE = 0.05


def channel_page(name: str = "motor_torque", models: tuple[str, ...] = ("nominal.yaml", "better.yaml")) -> ChannelPage:
    """A ripple of two cycles per motor turn is missing in the first model, half of it in the second."""
    time = np.arange(ROWS) * PERIOD
    position = 0.6 * np.sin(0.35 * time)
    velocity = np.gradient(position, time)
    shaft = RATIO * position
    scale = 1e-4 if name == "transmission" else 1.0
    noise = NOISE * np.random.default_rng(0).standard_normal(ROWS)
    used = np.abs(velocity) > 0.01
    measured = scale * (np.sin(time) + 0.3 * np.cos(2.0 * shaft) + noise)
    conditions = Conditions(
        np.sign(velocity),
        {
            "motor_velocity": np.abs(velocity),
            "joint_torque": 10.0 * np.cos(0.8 * time),
            "motor_shaft_position": np.mod(shaft, 2.0 * np.pi),
            "joint_position": position,
            "direction": np.sign(velocity),
            "reversal_time": np.mod(time, np.pi / 0.35) + PERIOD,
            "time": time,
        },
    )
    comparisons, maps, spectra = {}, {}, {}
    for i, model in enumerate(models):
        residual = scale * (0.3 / (i + 1) * np.cos(2.0 * shaft) + noise)
        comparisons[model] = ChannelComparison(name, time, used, measured, residual, residual, scale * NOISE)
        maps[model] = maps_of(conditions, residual, used)
        spectrum = order_spectrum([OrderRecord(time, shaft / (2.0 * np.pi), residual, used, 38.0)], RATIO)
        spectra[model] = (spectrum, lines_of(spectrum))
    first = comparisons[models[0]]
    windows = zoom_windows(time, used, first.residual, velocity, first.noise_floor)
    return ChannelPage(name, comparisons, maps, spectra, windows)


def diagnosis(verdict: str = MISSING, joint: str = "joint_1") -> JointDiagnosis:
    """One named effect with a runner-up, something unknown, an experiment; texts with signs that HTML must escape."""
    effect = NamedEffect(
        name="motor_cogging",
        title="Cogging",
        confidence=0.93,
        channel="motor_torque",
        gain=400.0,
        t=12.0,
        error_before=0.22,
        error_after=0.05,
        parameters={"cosine_2": Interval(0.3, 0.29, 0.31), "sine_2": Interval(0.01, -0.01, 0.03)},
        units={"cosine_2": "N m", "sine_2": "N m"},
        evidence="the residual repeats with the motor's turn & <twice>",
        rivals=(Rival("gauge_ripple", 120.0, 0.99, 0.6),),
    )
    unknown = Unknown("motor_torque", ("joint_position",), "motor torque: the residual depends on joint position")
    channels = {"motor_torque": ChannelError("N m", 1.0, 0.22, 0.05, NOISE)}
    experiments = (Experiment("cogging against ripple", "a slow move over 20 motor turns < 0.1 rad/s"),)
    return JointDiagnosis(
        joint, verdict, (effect,), unknown, experiments, channels, None, ("only 1 change of direction",)
    )


def report_page(joints: tuple[str, ...] = ("joint_1", "joint <2>")) -> ReportPage:
    """Two joints: one with everything, one with pictures only."""
    rungs = (Rung("as given", 7, 0.21, 0.22, NOISE), Rung("motor_cogging", 9, 0.049, 0.05, NOISE))
    horizon = np.geomspace(0.01, 5.0, 30)
    curves = (
        HorizonCurve("nominal.yaml", horizon, 1e-4 * horizon, "rad"),
        HorizonCurve("hold the last value", horizon, 1e-3 * horizon, "rad", baseline=True),
    )
    found = diagnosis()
    full = JointPage(
        joints[0],
        (channel_page(), channel_page("transmission")),
        found,
        (Ladder(rungs, "N m", "the noise floor is reached"),),
        parameter_rows(found),
        {"motor position": curves},
        ("3 gaps of 5 ms",),
    )
    plain = JointPage(joints[1], (channel_page(models=("nominal.yaml",)),))
    return ReportPage("Report <of> a test", "bags/run_1", ("nominal.yaml", "better.yaml"), (full, plain), "hd report")


def numbers(spec: Any) -> np.ndarray:
    """Numbers of a figure as plotly.js reads them."""
    return np.frombuffer(base64.b64decode(spec["bdata"]), dtype="<f4")
