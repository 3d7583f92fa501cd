"""The report page: complete, escaped, never overwritten, and drawn by a real browser without asking anybody."""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from report_case import report_page

from hd_control.core.errors import HdError
from hd_control.lab.page.page import (
    Figures,
    card,
    folded,
    grid,
    json_text,
    listed,
    number,
    paragraph,
    report_html,
    table,
    write_report,
)
from hd_control.lab.page.page_data import joint_page
from hd_control.lab.page.pictures import SCALE, WIDTH, find_browser, key_figures, look, write_pictures

needs_browser = pytest.mark.skipif(find_browser() is None, reason="no browser; .ci/run installs Debian's chromium")


class Outline(HTMLParser):
    """Tags that are open, and every address that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "link", "br", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_fetches_nothing() -> None:
    text = report_html(report_page())
    outline = Outline()
    outline.feed(text)
    assert outline.open == []
    assert {a for a in outline.addresses if not a.startswith(("#", "data:"))} == set()
    assert text.count("plotly.js v") == 1, "plotly.js is there once"
    assert "default-src 'none'" in text


def test_texts_are_escaped() -> None:
    text = report_html(report_page()).split("<script", 1)[0]
    assert "joint &lt;2&gt;" in text and "Report &lt;of&gt; a test" in text and "&amp; &lt;twice&gt;" in text
    assert "<twice>" not in text and "<of>" not in text


def test_the_verdict_comes_first_and_everything_is_there() -> None:
    text = report_html(report_page())
    places = [text.index(words) for words in ("Motor cogging is missing", "Where the error is", "Cycles per turn")]
    places += [text.index(words) for words in ("Free run", "95 % interval", "Notes on this joint")]
    assert places == sorted(places)
    assert "flat: the data do not fix it" in text and "What to record next" in text


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    path = write_report(tmp_path / "report.html", report_page())
    before = path.read_bytes()
    with pytest.raises(HdError, match="--force"):
        write_report(path, report_page())
    assert write_report(path, report_page(), force=True).read_bytes() == before, "the same page twice"
    with pytest.raises(HdError, match="report.html: cannot be written.*make it first"):
        write_report(tmp_path / "nowhere" / "report.html", report_page())
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"], "nothing half written stays"


@needs_browser
def test_a_browser_draws_every_figure_without_errors_or_requests(tmp_path: Path) -> None:
    path = write_report(tmp_path / "report.html", report_page())
    seen = look(path)
    places = len(re.findall(r'<div class="figure', seen.html))
    assert places > 20
    assert seen.html.count('data-state="drawn"') == places
    assert seen.html.count('class="main-svg"') >= places
    assert seen.console == () and seen.requests == ()


@needs_browser
def test_a_browser_would_show_an_error_and_a_request(tmp_path: Path) -> None:
    """The check above can fail."""
    path = tmp_path / "bad.html"
    path.write_text('<html><img src="http://192.0.2.1/a.png"><script>console.error("seen"); nothing();</script></html>')
    seen = look(path)
    assert any("seen" in line for line in seen.console) and any("nothing" in line for line in seen.console)
    assert "http://192.0.2.1/a.png" in seen.requests


@needs_browser
@pytest.mark.slow
def test_pictures_are_drawn_at_their_size(tmp_path: Path) -> None:
    page = report_page(("joint_1", "joint_2"))
    paths = {path.stem: path for path in write_pictures(tmp_path / "png", page)}
    figures = {f"{joint.joint}_{name}": f for joint in page.joints for name, f in key_figures(joint).items()}
    assert {"joint_1_confidence", "joint_1_ladder", "joint_1_motor_torque_orders"} <= set(paths) == set(figures)
    for name, path in paths.items():
        size = struct.unpack(">II", path.read_bytes()[16:24])
        assert size == (SCALE * WIDTH, SCALE * figures[name]["layout"]["height"]), name
    with pytest.raises(HdError, match="--force"):
        write_pictures(tmp_path / "png", report_page(("joint_1", "joint_2")))


def test_without_a_browser_one_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HD_BROWSER", "/no/such/browser")
    with pytest.raises(HdError, match="install chromium"):
        write_pictures(tmp_path / "png", report_page(("joint_1", "joint_2")))


@pytest.mark.slow
def test_a_page_of_a_simulated_joint() -> None:
    """From a recording through the engine: a ripple of the gauge shows as order 2 in the transmission."""
    from hd_control.lab.models.answers import joint_task
    from hd_control.lab.models.compare import compare
    from hd_sim.puzzles.campaign import nominal_model, recording
    from hd_sim.puzzles.recordings import make_pair

    pair = make_pair(34, "one")
    joint = pair.model["joint"]
    task = joint_task(recording(pair.fit, joint, pair.period), nominal_model(pair.model), joint)
    page = joint_page(joint, {"nominal": compare(task, None)})
    assert [channel.name for channel in page.channels] == ["motor_torque", "transmission", "link_torque"]
    transmission = page.channels[1]
    assert transmission.maps["nominal"].maps["motor_shaft_position"].explained > 0.8
    _, lines = transmission.spectra["nominal"]
    assert round(lines[0].order) == 2 and lines[0].directions == (-1, 1)
    assert {window.title for window in transmission.windows} >= {"one reversal"}


def test_numbers_that_json_does_not_know_become_null_and_no_script_ends_early() -> None:
    text = json_text({"a": [float("nan"), float("inf"), 1.5, (2,)], "b": "</script><x>"})
    assert text == '{"a":[null,null,1.5,[2]],"b":"<\\/script><x>"}'
    assert json.loads(text)["b"] == "</script><x>"


def test_pieces_are_escaped_and_vanish_when_they_would_be_empty() -> None:
    assert paragraph("a < b", "meta") == '<p class="meta">a &lt; b</p>' and paragraph("") == ""
    assert listed(["a & b"]) == "<ul><li>a &amp; b</li></ul>" and listed([]) == ""
    assert card() == grid([]) == folded("more") == ""
    assert folded("a<b", "<p>x</p>") == "<details><summary>a&lt;b</summary><p>x</p></details>"
    made = table(["n", "value"], [["a", "1"], ["<b>", "2"]], frozenset({1}))
    assert made.count('class="number"') == 3 and "&lt;b&gt;" in made


@pytest.mark.parametrize(
    ("value", "digits", "text"), [(None, 3, "–"), (float("nan"), 3, "–"), (0.0, 3, "0"), (1234.5, 3, "1.23e+03"),
                                  (0.012345, 4, "0.01235")]
)  # fmt: skip
def test_numbers_have_their_digits(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_the_table_of_a_channel_says_what_was_compared() -> None:
    """Error, share of the measured, refitted, floor, share that is no noise: of the made channel."""
    page = report_page()
    text = report_html(page)
    channel = page.joints[0].channels[0].models["nominal.yaml"]
    row = text[text.index("<td>nominal.yaml</td>") :].split("</tr>")[0]
    cells = re.findall(r'<td class="number">([^<]*)</td>', row)
    assert cells[0] == f"{channel.rms_error:.3g}" and cells[3] == f"{channel.noise_floor:.3g}"
    assert cells[1] == f"{100.0 * channel.rms_error / channel.rms_measured:.3g} %"
    assert cells[4] == f"{100.0 * channel.structured_fraction:.0f} %"


def test_figures_are_placed_in_order_with_their_data_at_the_end() -> None:
    figures = Figures()
    first, second = (figures.place({"data": [k], "layout": {"height": 100 + k}}) for k in (1, 2))
    assert 'data-figure="figure-1"' in first and "height:102px" in second
    blocks = re.findall(r'<script type="application/json" id="(figure-\d)">(.*?)</script>', figures.data)
    assert [(name, json.loads(text)["data"]) for name, text in blocks] == [("figure-1", [1]), ("figure-2", [2])]


def test_every_figure_of_the_page_has_its_place_and_its_data() -> None:
    text = report_html(report_page())
    places = re.findall(r'data-figure="(figure-\d+)"', text)
    data = re.findall(r'<script type="application/json" id="(figure-\d+)">', text)
    assert places and sorted(places) == sorted(data) and len(set(places)) == len(places)


def test_only_several_joints_need_a_navigation() -> None:
    page = report_page()
    one = replace(page, joints=page.joints[:1])
    assert "<nav>" in report_html(page) and "<nav>" not in report_html(one)
