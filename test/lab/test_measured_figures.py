"""Pictures of what was measured carry the numbers that they are given."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pytest
from plain_joint import NAME, equations, model, recording, signals

from hd_control.lab.maps.friction_curve import Condition, FrictionCurve, FrictionPoint, friction_curves
from hd_control.lab.maps.signal_spectra import CLEAR, HertzLine, SignalSpectrum, signal_spectra
from hd_control.lab.models.answers import compare_joint
from hd_control.lab.page.measured_figures import density_figure, friction_figure, friction_group_figure
from hd_control.lab.page.page import report_html
from hd_control.lab.page.page_data import ReportPage, joint_page
from hd_control.lab.page.pictures import key_figures


def numbers(item: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(item["bdata"]), "<f4")


def lines_with_markers(figure: dict[str, Any]) -> list[dict[str, Any]]:
    return [trace for trace in figure["data"] if trace["mode"] == "lines+markers"]


def test_a_friction_curve_is_drawn_signed_with_its_intervals() -> None:
    curve = friction_curves(equations())[0]
    figure = friction_figure(curve)
    backward, forward = lines_with_markers(figure)
    for trace, sign in ((backward, -1), (forward, 1)):
        points = curve.of(sign)
        np.testing.assert_allclose(numbers(trace["x"]), [sign * p.speed for p in points], rtol=1e-6)
        np.testing.assert_allclose(numbers(trace["y"]), [sign * p.torque for p in points], rtol=1e-6)
    band = next(t for t in figure["data"] if t.get("fill") and t["name"] == "forward")
    known = [p for p in curve.of(1) if np.isfinite(p.low)]
    np.testing.assert_allclose(numbers(band["y"])[: len(known)], [p.low for p in known], rtol=1e-5)
    np.testing.assert_allclose(numbers(band["y"])[len(known) :], [p.high for p in known][::-1], rtol=1e-5)


def test_one_speed_has_bars_and_no_interval_is_no_band() -> None:
    one = FrictionCurve(
        "gauge_torque",
        (FrictionPoint(-1, 0.1, 3.0, 2.8, 3.3, 9.0), FrictionPoint(1, 0.1, 4.0, np.nan, np.nan, 0.3)),
        (),
        0.0,
    )
    backward, forward = lines_with_markers(friction_figure(one))
    assert numbers(backward["error_y"]["array"]) == pytest.approx([0.2])
    assert numbers(backward["error_y"]["arrayminus"]) == pytest.approx([0.3]), "turned to the side of its direction"
    assert "error_y" not in forward
    assert not [t for t in friction_figure(one)["data"] if t.get("fill") and t["name"] == "forward"]


def test_groups_have_a_line_each() -> None:
    low, high = Condition("load", "N m", 0.0, 5.0), Condition("load", "N m", 5.0, 10.0)
    point = FrictionPoint(0, 0.2, 3.0, 2.9, 3.1, 9.0)
    other = FrictionPoint(0, 0.2, 4.0, 3.9, 4.1, 9.0)
    forward = FrictionPoint(1, 0.2, 9.0, 8.9, 9.1, 9.0)
    curve = FrictionCurve("motor_torque", (point,), (), 0.0, {low: (point, forward), high: (other,)})
    drawn = lines_with_markers(friction_group_figure(curve, "load"))
    assert [trace["name"] for trace in drawn] == ["0 … 5 N m", "5 … 10 N m"]
    assert [numbers(trace["y"]).tolist() for trace in drawn] == [[3.0], [4.0]], "both directions together"
    assert friction_group_figure(curve, "temperature")["data"] == []


def test_a_density_shows_floor_and_lines() -> None:
    spectrum = signal_spectra(equations())[1]
    marked = (HertzLine(20.0, 0.3, 0.1, 0.01), HertzLine(40.0, 0.3, 0.1, 0.01, 4.0))
    figure = density_figure(
        SignalSpectrum(
            spectrum.signal, spectrum.unit, spectrum.orders, (), spectrum.frequency, spectrum.density, spectrum.floor,
            marked,
        )
    )  # fmt: skip
    level, floor = figure["data"]
    np.testing.assert_allclose(numbers(level["y"]), np.sqrt(spectrum.density), rtol=1e-5)
    np.testing.assert_allclose(numbers(floor["y"]), np.sqrt(CLEAR * spectrum.floor), rtol=1e-5)
    assert [item["text"] for item in figure["layout"]["annotations"]] == ["20 Hz", "order 4"]
    assert figure["layout"]["annotations"][0]["x"] == pytest.approx(np.log10(20.0))


def test_the_page_and_the_key_figures_show_them() -> None:
    seen = compare_joint(recording(signals()), model(), NAME, free_run=False).observations
    page = joint_page(NAME, {}, observations=seen)
    text = report_html(ReportPage("t", "bag", ("m.yaml",), (page,)))
    for words in ("What was measured", "Friction that the motor torque shows", "Order spectrum of the torsion itself"):
        assert words in text
    assert "friction_motor_torque" in key_figures(page)
    assert "What was measured" not in report_html(ReportPage("t", "bag", ("m.yaml",), (joint_page(NAME, {}),)))
