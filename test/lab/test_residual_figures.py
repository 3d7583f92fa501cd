"""Pictures of residuals: means, shares, crosses and lines are the numbers of the maps and spectra behind them."""

from __future__ import annotations

import numpy as np
import pytest
from report_case import channel_page, numbers

from hd_control.lab.maps.condition_maps import LEAST_EFFECTIVE
from hd_control.lab.maps.orders import BACKWARD, FORWARD, LINE_FACTOR
from hd_control.lab.page.residual_figures import heat_figure, largest_rms, map_figure, order_figure

PAGE = channel_page()


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


def test_shares_of_a_map_are_the_first_models_in_per_cent() -> None:
    both = {name: maps.maps["joint_position"] for name, maps in PAGE.maps.items()}
    figure = map_figure(both, "N m")
    bars = [t for t in figure["data"] if t["type"] == "bar"]
    total = sum(float(numbers(t["y"]).sum()) for t in bars)
    assert total == pytest.approx(100.0, rel=1e-4)
    item = both["nominal.yaml"]
    np.testing.assert_allclose(numbers(bars[-1]["y"]), 100.0 * item.bins.share[2], rtol=1e-5)
    curves = [t for t in figure["data"] if t.get("mode") == "lines+markers"]
    assert {t["line"]["dash"] for t in curves} == {"solid", "dash"}, "models differ by their dash"
    assert {t["name"] for t in curves} == {f"{m}, {d}" for m in both for d in ("backward", "forward")}


def test_angles_are_in_degrees_and_speeds_on_a_logarithm() -> None:
    maps = PAGE.maps["nominal.yaml"].maps
    angle = map_figure({"m": maps["joint_position"]}, "N m")
    x = numbers(angle["data"][0]["x"])
    edges = np.degrees(maps["joint_position"].edges)
    np.testing.assert_allclose(x, 0.5 * (edges[1:] + edges[:-1]), rtol=1e-5)
    assert angle["layout"]["xaxis"]["title"]["text"] == "joint angle, degrees"
    speed = map_figure({"m": maps["motor_velocity"]}, "N m")
    edges = maps["motor_velocity"].edges
    low = edges[0] if edges[0] > 0.0 else 0.5 * edges[1]
    assert speed["layout"]["xaxis"]["range"] == pytest.approx([np.log10(low), np.log10(edges[-1])])
    ticks = dict(zip(speed["layout"]["xaxis"]["tickvals"], speed["layout"]["xaxis"]["ticktext"], strict=True))
    assert all(float(text) == pytest.approx(10.0**value) for value, text in ticks.items())


def test_directions_are_a_map_with_three_named_places() -> None:
    item = PAGE.maps["nominal.yaml"].maps["direction"]
    shown = map_figure({"m": item}, "N m")["layout"]["xaxis"]
    assert (shown["tickvals"], shown["ticktext"]) == ([-1, 0, 1], ["backward", "at rest", "forward"])


def test_what_explains_the_error_is_said_above_the_map() -> None:
    item = PAGE.maps["nominal.yaml"].maps["motor_shaft_position"]
    title = map_figure({"m": item}, "N m")["layout"]["title"]["text"]
    assert title == f"Over motor angle — its mean explains {100.0 * item.explained:.0f} % of the error"
    assert map_figure({"m": PAGE.maps["nominal.yaml"].maps["time"]}, "N m")["layout"]["title"]["text"] == "Over time"


def test_empty_bins_of_a_heat_map_stay_empty() -> None:
    item = PAGE.maps["nominal.yaml"].speed_load
    assert item is not None
    heat = [t for t in heat_figure(item, "N m")["data"] if t["type"] == "heatmap"]
    for trace, k in zip(heat, (0, 2), strict=True):
        shown = numbers(trace["z"]).reshape(item.bins.rms[k].T.shape)
        np.testing.assert_array_equal(np.isnan(shown), item.bins.count[k].T == 0)


def test_heat_maps_that_are_compared_have_the_same_colours() -> None:
    items = {name: maps.speed_load for name, maps in PAGE.maps.items()}
    first = items["nominal.yaml"]
    assert first is not None
    top = largest_rms(first)
    assert top == np.nanmax(first.bins.rms)
    for item in items.values():
        assert item is not None
        heat = [t for t in heat_figure(item, "N m", "m", top)["data"] if t["type"] == "heatmap"]
        assert {trace["zmax"] for trace in heat} == {top}
        np.testing.assert_allclose(
            numbers(heat[1]["z"]).reshape(item.bins.rms[2].T.shape), item.bins.rms[2].T, rtol=1e-5
        )
    own = [t for t in heat_figure(first, "rad")["data"] if t["type"] == "heatmap"]
    assert own[0]["zmax"] == pytest.approx(1e6 * top), "in microradians"
    crosses = sum(numbers(t["x"]).size for t in heat_figure(first, "N m")["data"] if t["type"] == "scatter")
    assert crosses == first.bins.few[[0, 2]].sum()


def test_the_order_figure_marks_the_line() -> None:
    spectrum, lines = PAGE.spectra["nominal.yaml"]
    figure = order_figure(spectrum, lines, "N m")
    marks = next(t for t in figure["data"] if t["name"] == "lines")
    assert numbers(marks["x"])[0] == pytest.approx(2.0, abs=0.05)
    assert numbers(marks["y"])[0] == pytest.approx(0.3, rel=0.1)
    assert figure["layout"]["annotations"][0]["text"] == "2"


def test_the_order_figure_draws_both_directions_and_the_height_that_names_a_line() -> None:
    spectrum, lines = PAGE.spectra["nominal.yaml"]
    figure = order_figure(spectrum, lines, "rad")
    by_name = {t["name"]: t for t in figure["data"]}
    for name, direction in (("backward", BACKWARD), ("forward", FORWARD)):
        one = spectrum.directions[direction]
        np.testing.assert_allclose(numbers(by_name[name]["y"]), 1e6 * one.amplitude, rtol=1e-5)
    floor = np.fmax(spectrum.directions[FORWARD].floor, spectrum.directions[BACKWARD].floor)
    np.testing.assert_allclose(
        numbers(by_name[f"{LINE_FACTOR:g} x local floor"]["y"]), LINE_FACTOR * 1e6 * floor, rtol=1e-5
    )
    low, high = spectrum.range
    assert figure["layout"]["xaxis"]["range"] == pytest.approx([np.log10(low), np.log10(high)])
    assert figure["layout"]["xaxis"]["title"]["text"] == f"cycles per {spectrum.turn}"
