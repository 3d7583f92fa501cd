"""Pictures of models: what they draw is what they were given, in the unit that they say."""

from __future__ import annotations

import numpy as np
import pytest
from report_case import NOISE, channel_page, numbers

from hd_control.lab.maps.zoom import Window
from hd_control.lab.page.model_figures import (
    Bar,
    HorizonCurve,
    Rung,
    confidence_figure,
    horizon_figure,
    ladder_figure,
    overlay_figure,
    percent,
    percent_of,
    replay_figure,
)

PAGE = channel_page()


def test_the_overlay_draws_measurement_model_and_residual() -> None:
    figure = overlay_figure(PAGE.models)
    by_name = {(t["name"], t.get("yaxis", "y")): t for t in figure["data"]}
    assert set(by_name) == {("measured", "y")} | {(m, y) for m in PAGE.models for y in ("y", "y2")}
    channel = PAGE.models["nominal.yaml"]
    largest = np.abs(channel.residual[channel.used]).max()
    assert np.nanmax(np.abs(numbers(by_name["nominal.yaml", "y2"]["y"]))) == pytest.approx(largest, rel=1e-5)
    band = figure["layout"]["shapes"][0]
    assert (band["y0"], band["y1"]) == pytest.approx((-2.0 * NOISE, 2.0 * NOISE))


def test_the_model_is_the_measurement_less_the_residual() -> None:
    figure = overlay_figure(PAGE.models, Window("x", 5.0, 9.0))
    by_name = {(t["name"], t.get("yaxis", "y")): t for t in figure["data"]}
    channel = PAGE.models["better.yaml"]
    rows = Window("x", 5.0, 9.0).rows(channel.time)
    said, left = (numbers(by_name["better.yaml", y]["y"]) for y in ("y", "y2"))
    used = channel.used[rows]
    np.testing.assert_allclose(said[np.isfinite(said)], (channel.measured - channel.residual)[rows][used], atol=1e-5)
    np.testing.assert_allclose(left[np.isfinite(left)], channel.residual[rows][used], atol=1e-6)
    assert figure["layout"]["xaxis"]["range"] == [5.0, 9.0] and figure["layout"]["title"]["text"] == "X"


def test_small_angles_are_drawn_in_microradians_about_their_mean() -> None:
    page = channel_page("transmission")
    figure = overlay_figure(page.models)
    measured = numbers(figure["data"][0]["y"])
    channel = page.models["nominal.yaml"]
    expected = 1e6 * (channel.measured - channel.measured[channel.used].mean())[channel.used]
    assert np.nanmax(measured) == pytest.approx(expected.max(), rel=1e-5)
    assert figure["layout"]["yaxis"]["title"]["text"] == "µrad"
    assert figure["layout"]["shapes"][0]["y1"] == pytest.approx(2.0 * 1e6 * 1e-4 * NOISE)


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


def test_the_ladder_draws_held_out_bars_training_marks_and_the_floor() -> None:
    steps = [Rung("as given", 7, 0.2e-3, 0.3e-3, 1e-5), Rung("payload", 9, 0.1e-3, 0.12e-3, 2e-5)]
    bars, level, train = ladder_figure(steps, "rad", "the noise floor is reached")["data"]
    assert bars["y"] == pytest.approx([300.0, 120.0]) and train["y"] == pytest.approx([200.0, 100.0])
    assert level["y"] == pytest.approx([10.0, 20.0])
    shown = ladder_figure(steps, "rad", "the noise floor is reached")["layout"]
    assert shown["xaxis"]["title"]["text"] == "stopped: the noise floor is reached"
    assert shown["yaxis"]["title"]["text"] == "RMS error, µrad" and shown["yaxis"]["range"][1] > 300.0
    empty = ladder_figure([], "N m")
    assert empty["data"][0]["y"] == [], "a ladder without rungs is an empty picture"


@pytest.mark.parametrize(
    ("ratio", "text"), [(1.0, "100 %"), (0.5, "50 %"), (0.0996, "10 %"), (0.0994, "9.9 %"), (0.0039, "0.39 %")]
)
def test_small_shares_keep_two_digits(ratio: float, text: str) -> None:
    assert percent_of(ratio) == text


def test_no_probability_is_a_certainty() -> None:
    assert [percent(p) for p in (1.0, 0.995, 0.99, 0.5, 0.0)] == ["> 99 %", "> 99 %", "99 %", "50 %", "0 %"]


def test_bars_of_confidence_are_percent_with_their_notes() -> None:
    figure = confidence_figure([Bar("motor_cogging", 0.93, "runner-up: x, would explain 60 %"), Bar("unknown", None)])
    (trace,) = figure["data"]
    assert trace["x"] == [93.0, 100.0] and trace["y"] == ["motor cogging", "unknown"]
    assert trace["text"] == ["93 %", ""] and trace["marker"]["pattern"]["shape"] == ["", "/"]
    (text,) = figure["layout"]["annotations"]
    assert text["y"] == "motor cogging" and text["text"] == "runner-up: x,<br>would explain 60 %"
    taller = confidence_figure([Bar("a", 0.1)] * 4)
    assert taller["layout"]["height"] > figure["layout"]["height"]


def test_free_runs_are_drawn_where_a_logarithm_exists() -> None:
    horizon = np.array([0.0, 0.1, 1.0, 2.0, 3.0])
    error = np.array([1e-6, 2e-6, 0.0, np.nan, 4e-6])
    figure = horizon_figure(
        [HorizonCurve("m", horizon, error, "rad"), HorizonCurve("hold", horizon, error, "rad", True)], "x"
    )
    model, hold = figure["data"]
    np.testing.assert_allclose(numbers(model["x"]), [0.1, 3.0], rtol=1e-6)
    np.testing.assert_allclose(numbers(model["y"]), [2.0, 4.0], rtol=1e-6)
    assert (model["line"]["dash"], hold["line"]["dash"]) == ("solid", "dash")
    assert figure["layout"]["yaxis"]["title"]["text"] == "RMS error, µrad"
    assert horizon_figure([], "x")["data"] == []


def test_a_replay_shows_the_joint_that_differs_most_and_every_difference() -> None:
    time = np.arange(50.0)
    recorded = np.stack([np.sin(time), np.cos(time), time], axis=1)
    made = recorded.copy()
    made[10, 1] += 0.5
    made[20, 2] += 0.1
    made[30, 2] = np.nan
    figure = replay_figure("title", "N m", time, recorded, made, ["a", "b", "c"])
    names = [trace["name"] for trace in figure["data"]]
    assert names == ["b recorded", "b replayed", "b", "c"], "the first joint is equal and has no line"
    difference = numbers(figure["data"][3]["y"])
    assert np.nanmax(difference) == pytest.approx(0.1, rel=1e-5) and np.isnan(difference[30])
    assert np.nanmax(np.abs(numbers(figure["data"][2]["y"]))) == pytest.approx(0.5)
