"""What all pictures share: numbers packed and thinned so that nothing that matters goes, axes, one page on its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects
import pytest
from report_case import numbers

from hd_control.core.errors import HdError
from hd_control.lab.page.style import POINTS, axis, kept, layout, line, note, packed, thinned, with_gaps, write_page


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


@pytest.mark.parametrize("seed", range(5))
def test_every_extreme_of_a_bin_stays(seed: int) -> None:
    """Largest and smallest of each stretch of two points of the picture, whatever the series is."""
    random = np.random.default_rng(seed)
    series = np.cumsum(random.standard_normal(60_000))
    keep = thinned(series)
    assert keep.size <= POINTS and (np.diff(keep) > 0).all()
    for start in range(0, 60_000, 6000):
        part = slice(start, start + 6000)
        inside = keep[(keep >= start) & (keep < start + 6000)]
        spread = np.ptp(series[part]) / 100.0
        assert (
            series[inside].max() >= series[part].max() - spread and series[inside].min() <= series[part].min() + spread
        )
    assert {int(np.argmax(series)), int(np.argmin(series))} <= set(keep.tolist())


def test_short_series_are_drawn_whole() -> None:
    np.testing.assert_array_equal(thinned(np.arange(5.0)), np.arange(5))
    np.testing.assert_array_equal(thinned(np.zeros(POINTS)), np.arange(POINTS))
    assert thinned(np.sin(np.arange(10_000.0)), 11).size <= 11


def test_more_gaps_than_points_are_not_all_drawn() -> None:
    """Every second row missing: the ends of the gaps alone would be the whole series."""
    used = np.arange(100_000) % 2 == 0
    assert kept(np.sin(np.arange(100_000) / 1e3), used).size <= POINTS


def test_a_line_takes_further_keys_in_place_of_its_own() -> None:
    trace = line(np.arange(3.0), np.ones(3), "x", "#123456", dash="dot", width=2.0, mode="markers", yaxis="y2")
    assert trace["line"] == {"color": "#123456", "width": 2.0, "dash": "dot"}
    assert (trace["mode"], trace["yaxis"], trace["name"]) == ("markers", "y2", "x")
    np.testing.assert_array_equal(numbers(trace["x"]), [0.0, 1.0, 2.0])


def test_axes_and_notes_keep_the_style_and_take_more() -> None:
    assert axis("time, s", type="log", gridcolor="#000000")["gridcolor"] == "#000000"
    assert axis("time, s")["title"]["text"] == "time, s"
    assert layout("title", 300, barmode="stack")["barmode"] == "stack" and layout("t", 300)["height"] == 300
    assert note("x", 1.0, "y", yshift=5)["yshift"] == 5


def test_a_page_of_one_picture_needs_no_network(tmp_path: Path) -> None:
    figure = plotly.graph_objects.Figure({"data": [line(np.arange(3.0), np.ones(3), "x", "#123456")]})
    text = write_page(figure, tmp_path / "page.html").read_text()
    assert "plotly.js v" in text and "cdn.plot.ly" not in text.split("</script>")[-2]
    with pytest.raises(HdError, match="cannot be written"):
        write_page(figure, tmp_path / "nowhere" / "page.html")
