"""Pictures are valid for plotly, keep what matters, and say what the numbers say."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any

import numpy as np
import plotly.graph_objects
import pytest
from report_case import NOISE, PERIOD, channel_page, diagnosis

from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, UNKNOWN
from hd_control.lab.maps.condition_maps import LEAST_EFFECTIVE
from hd_control.lab.maps.orders import OrderRecord, lines_of, order_spectrum
from hd_control.lab.maps.zoom import zoom_windows
from hd_control.lab.page.model_figures import (
    Bar,
    HorizonCurve,
    Rung,
    confidence_figure,
    horizon_figure,
    ladder_figure,
    overlay_figure,
)
from hd_control.lab.page.residual_figures import heat_figure, map_figure, order_figure
from hd_control.lab.page.style import Figure, kept, packed, with_gaps
from hd_control.lab.page.words import confidence_bars, headline, reasons

PAGE = channel_page()


def numbers(spec: Any) -> np.ndarray:
    """What `packed` packed."""
    return np.frombuffer(base64.b64decode(spec["bdata"]), dtype="<f4")


def all_figures() -> Iterator[tuple[str, Figure]]:
    """Every kind of picture."""
    unit = "N m"
    yield "overlay", overlay_figure(PAGE.models)
    yield from ((w.title, overlay_figure(PAGE.models, w)) for w in PAGE.windows)
    first = PAGE.maps["nominal.yaml"]
    yield from ((name, map_figure({m: maps.maps[name] for m, maps in PAGE.maps.items()}, unit)) for name in first.maps)
    assert first.speed_load is not None
    yield "heat", heat_figure(first.speed_load, unit, "nominal.yaml")
    yield "orders", order_figure(*PAGE.spectra["nominal.yaml"], unit)
    yield "no orders", order_figure(*nothing(), unit)
    yield (
        "ladder",
        ladder_figure([Rung("as given", 7, 0.2, 0.3, 0.1), Rung("payload", 9, 0.1, 0.12, 0.1)], unit, "floor"),
    )
    yield "confidence", confidence_figure([Bar("payload", 0.9, "runner-up: gauge gain"), Bar("unknown", None)])
    curve = HorizonCurve("model", np.linspace(0.0, 5.0, 20), np.linspace(0.0, 1.0, 20), "rad")
    yield "horizon", horizon_figure([curve], "motor position")


def nothing() -> tuple[Any, Any]:
    """The spectrum of a joint that rests."""
    time = np.arange(1000) * PERIOD
    still = OrderRecord(time, np.zeros(1000), np.ones(1000), np.ones(1000, dtype=bool), 38.0)
    spectrum = order_spectrum([still], 100.0)
    return spectrum, lines_of(spectrum)


@pytest.mark.parametrize(("name", "figure"), [pytest.param(n, f, id=n) for n, f in all_figures()])
def test_plotly_takes_every_figure(name: str, figure: Figure) -> None:
    plotly.graph_objects.Figure(figure)  # raises on any key or value that plotly does not know
    assert figure["layout"]["height"] > 100


def test_packed_numbers_come_back() -> None:
    values = np.array([1.5, np.nan, -2e-6])
    np.testing.assert_allclose(numbers(packed(values)), values, rtol=1e-6)
    assert packed(np.zeros((3, 2)))["shape"] == "3, 2"


def test_thinning_keeps_extremes_and_the_ends_of_gaps() -> None:
    values = np.sin(np.arange(100_000) / 1000.0)
    values[54_321] = 9.0
    used = np.ones(values.size, dtype=bool)
    used[70_000:70_100] = False
    keep = kept(values, used)
    assert keep.size < 3000 and {54_321, 69_999, 70_000, 70_099, 70_100} <= set(keep.tolist())
    shown = with_gaps(values, used)[keep]
    assert np.nanmax(shown) == 9.0 and np.isnan(shown).sum() >= 2


def test_the_overlay_draws_measurement_model_and_residual() -> None:
    figure = overlay_figure(PAGE.models)
    by_name = {(t["name"], t.get("yaxis", "y")): t for t in figure["data"]}
    assert set(by_name) == {("measured", "y")} | {(m, y) for m in PAGE.models for y in ("y", "y2")}
    channel = PAGE.models["nominal.yaml"]
    largest = np.abs(channel.residual[channel.used]).max()
    assert np.nanmax(np.abs(numbers(by_name["nominal.yaml", "y2"]["y"]))) == pytest.approx(largest, rel=1e-5)
    band = figure["layout"]["shapes"][0]
    assert (band["y0"], band["y1"]) == pytest.approx((-2.0 * NOISE, 2.0 * NOISE))


def test_windows_show_what_they_say() -> None:
    time = np.arange(7500) * PERIOD
    velocity = np.where(time < 20.0, 0.3, 0.5 * np.sin(time))
    residual = 0.01 * np.ones(time.size)
    residual[(time > 41.0) & (time < 44.0)] = 1.0
    largest, turn, steady = zoom_windows(time, np.ones(time.size, dtype=bool), residual, velocity, 0.01)
    assert (
        largest.start <= 41.0 and largest.end >= 44.0 and largest.end - largest.start == pytest.approx(5.0, abs=PERIOD)
    )
    inside = velocity[turn.rows(time)]
    assert inside[0] * inside[-1] < 0.0
    assert np.ptp(velocity[steady.rows(time)]) == 0.0 and steady.end <= 20.0 + PERIOD
    assert zoom_windows(time, np.zeros(time.size, dtype=bool), residual, velocity, 0.01) == ()


def test_a_map_draws_each_direction_and_crosses_where_samples_are_few() -> None:
    item = PAGE.maps["nominal.yaml"].maps["motor_shaft_position"]
    figure = map_figure({"nominal.yaml": item}, "N m")
    lines = {
        t["name"]: numbers(t["y"]) for t in figure["data"] if t["mode" if "mode" in t else "type"] == "lines+markers"
    }
    assert set(lines) == {"backward", "forward"}
    np.testing.assert_allclose(lines["forward"], item.bins.mean[2], rtol=1e-5)
    crosses = sum(numbers(t["x"]).size for t in figure["data"] if t.get("mode") == "markers")
    few = (item.bins.count > 0) & (item.bins.effective < LEAST_EFFECTIVE)
    assert crosses == few.sum()


def test_empty_bins_of_a_heat_map_stay_empty() -> None:
    item = PAGE.maps["nominal.yaml"].speed_load
    assert item is not None
    heat = [t for t in heat_figure(item, "N m")["data"] if t["type"] == "heatmap"]
    for trace, k in zip(heat, (0, 2), strict=True):
        shown = numbers(trace["z"]).reshape(item.bins.rms[k].T.shape)
        np.testing.assert_array_equal(np.isnan(shown), item.bins.count[k].T == 0)


def test_the_order_figure_marks_the_line() -> None:
    spectrum, lines = PAGE.spectra["nominal.yaml"]
    figure = order_figure(spectrum, lines, "N m")
    marks = next(t for t in figure["data"] if t["name"] == "lines")
    assert numbers(marks["x"])[0] == pytest.approx(2.0, abs=0.05)
    assert numbers(marks["y"])[0] == pytest.approx(0.3, rel=0.1)
    assert figure["layout"]["annotations"][0]["text"] == "2"


def test_the_ladder_reads_the_json_form_and_gives_percent() -> None:
    form = {"effect": "payload", "parameters_count": 9, "error_train": None, "error_held_out": 0.15, "noise_floor": 0.1}
    figure = ladder_figure([Rung("as given", 7, 0.2, 0.3, 0.1), Rung.of(form)], "N m")
    assert figure["data"][0]["text"] == ["0.3 (100 %)", "0.15 (50 %)"]


def test_a_refit_adds_nothing_and_looks_so() -> None:
    rungs = [
        Rung(name, 7, 1.0, error, 0.1) for name, error in (("as given", 7.16), ("refit", 14.4), ("payload", 0.028))
    ]
    bars = ladder_figure(rungs, "N m")["data"][0]
    assert bars["text"] == ["7.16 (100 %)", "14.4 (201 %)", "0.028 (0.39 %)"]
    assert bars["x"][1] == "only<br>refitted"
    first, second, third = bars["marker"]["color"]
    assert first == second != third


def test_answers_without_a_probability_are_bars_too() -> None:
    bars = confidence_bars(diagnosis())
    assert [(bar.name, bar.probability) for bar in bars] == [("motor_cogging", 0.93), ("unknown", None)]
    assert bars[0].note == "runner-up: gauge ripple, would explain 60 % of the gain"
    assert confidence_bars(diagnosis(CANNOT_TELL))[-1].name == "cannot_tell"
    pattern = confidence_figure(bars)["data"][0]["marker"]["pattern"]["shape"]
    assert pattern == ["", "/"]


def test_the_verdict_in_words() -> None:
    assert headline(diagnosis()) == "Motor cogging is missing in the model."
    assert "nothing is missing" in headline(diagnosis(ADEQUATE))
    assert "not in the library" in headline(diagnosis(UNKNOWN))
    assert "does not excite" in headline(diagnosis(CANNOT_TELL))
    first, second = reasons(diagnosis())
    assert "93 % sure" in first and "from 0.22 to 0.05 N m" in first and second.endswith("joint position.")
