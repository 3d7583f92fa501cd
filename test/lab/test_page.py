"""The report page: complete, escaped, never overwritten, and drawn by a real browser without asking anybody."""

from __future__ import annotations

import re
import struct
from html.parser import HTMLParser
from pathlib import Path

import pytest
from report_case import report_page

from hd_control.core.errors import HdError
from hd_control.lab.page.page import report_html, write_report
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
