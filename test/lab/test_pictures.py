"""Pictures by an installed browser: what is drawn, what a browser reports, and what is said where none is there.

The browser here is a small script that writes down how it was called and answers what a test gives it.
"""

from __future__ import annotations

import base64
import json
import stat
from pathlib import Path

import pytest
from report_case import report_page

from hd_control.core.errors import HdError
from hd_control.lab.maps.condition_maps import dependence
from hd_control.lab.page import pictures
from hd_control.lab.page.page_data import JointPage
from hd_control.lab.page.pictures import (
    browser,
    find_browser,
    key_figures,
    look,
    screenshot,
    write_figures,
    write_pictures,
)

PNG = b"\x89PNG made"


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def] # a function that makes one
    """A browser that runs the given shell lines; `$page` is the address, `$LOG` where its words go."""

    def make(lines: str) -> Path:
        script = tmp_path / "browser"
        log = tmp_path / "called"
        text = f'#!/bin/sh\nfor page in "$@"; do :; done\nprintf "%s\\n" "$@" > {log}\n{lines}\n'
        script.write_text(text)
        script.chmod(script.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("HD_BROWSER", str(script))
        return log

    return make


def test_the_browser_that_is_named_comes_first(fake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake("exit 0")
    assert find_browser() == browser() == str(tmp_path / "browser")
    monkeypatch.setenv("HD_BROWSER", str(tmp_path / "none"))
    assert find_browser() is None, "a wrong name is not replaced by another browser"
    with pytest.raises(HdError, match="no browser for pictures; install chromium, or name one in HD_BROWSER"):
        browser()
    monkeypatch.delenv("HD_BROWSER")
    monkeypatch.setattr(pictures.shutil, "which", lambda name: f"/bin/{name}" if name == "google-chrome" else None)
    assert find_browser() == "/bin/google-chrome"


def test_a_look_gives_text_console_and_addresses(fake, tmp_path: Path) -> None:
    """Of the network log what the page asked for: not itself, nothing local, nothing of the browser's own."""
    page = tmp_path / "page.html"
    page.write_text("<html></html>")
    address = page.resolve().as_uri()
    events = [
        {"params": {"url": "http://192.0.2.1/a.png", "initiator": address}},
        {"params": {"url": "http://192.0.2.2/own", "initiator": "not an origin"}},
        {"params": {"url": f"{address}#all", "initiator": address}},
        {"params": {"url": "data:image/png;base64,AA", "initiator": address}},
        {"params": {}},
        {},
    ]
    (tmp_path / "events.json").write_text(json.dumps({"events": events}))
    called = fake(
        f'for w in "$@"; do case "$w" in --log-net-log=*) cp {tmp_path}/events.json "${{w#*=}}";; esac; done\n'
        "echo '<html>drawn</html>'\n"
        "echo '[1:1:INFO:CONSOLE(1)] \"seen\", source: x' >&2\necho 'other words' >&2"
    )
    seen = look(page)
    assert seen.html == "<html>drawn</html>\n" and seen.requests == ("http://192.0.2.1/a.png",)
    assert seen.console == ('"seen", source: x',)
    words = called.read_text().splitlines()
    assert words[-1] == f"{address}#all" and "--dump-dom" in words and "--headless=new" in words
    assert "--disable-background-networking" in words, "no connection of its own accord"


def test_a_screenshot_is_a_file_or_an_error(fake, tmp_path: Path) -> None:
    page, picture = tmp_path / "page.html", tmp_path / "p.png"
    page.write_text("<html></html>")
    called = fake('for w in "$@"; do case "$w" in --screenshot=*) printf made > "${w#*=}";; esac; done')
    assert screenshot(page, picture, 640, 480, everything=False).read_bytes() == b"made"
    words = called.read_text().splitlines()
    assert "--window-size=640,480" in words and words[-1] == page.resolve().as_uri()
    fake("exit 0")
    with pytest.raises(HdError, match="the browser drew no picture"):
        screenshot(page, tmp_path / "other.png")


def test_a_browser_that_hangs_or_does_not_start_is_one_line(fake, tmp_path: Path, monkeypatch) -> None:
    page = tmp_path / "page.html"
    page.write_text("<html></html>")
    fake("exec sleep 20")
    monkeypatch.setattr(pictures, "TIMEOUT_S", 0.5)
    with pytest.raises(HdError, match=r"the browser did not finish .*page\.html#all within 0\.5 s"):
        look(page)
    monkeypatch.setattr(pictures, "browser", lambda: str(tmp_path))
    with pytest.raises(HdError, match="cannot be started"):
        look(page)


def drawing(*names: str) -> str:
    """Shell lines that answer as a page with these pictures drawn."""
    data = base64.b64encode(PNG).decode()
    return "\n".join(f"echo '<pre id=\"{name}\">data:image/png;base64,{data}</pre>'" for name in names)


def test_figures_are_written_under_safe_names_and_never_over_others(fake, tmp_path: Path) -> None:
    figures = {
        "joint <2>_ladder": {"data": [], "layout": {"height": 300}},
        "plain": {"data": [], "layout": {"height": 1}},
    }
    fake(drawing(*figures))
    paths = write_figures(tmp_path / "png", figures)
    assert [path.name for path in paths] == ["joint__2__ladder.png", "plain.png"]
    assert all(path.read_bytes() == PNG for path in paths)
    with pytest.raises(HdError, match="exists already; choose another folder or add --force"):
        write_figures(tmp_path / "png", figures)
    assert write_figures(tmp_path / "png", figures, force=True) == paths
    fake(drawing("plain"))
    with pytest.raises(HdError, match='the browser drew no picture of "joint <2>_ladder"'):
        write_figures(tmp_path / "more", figures)
    fake(drawing(*figures))
    (tmp_path / "file").write_text("x")
    with pytest.raises(HdError, match="file"):
        write_figures(tmp_path / "file" / "png", figures)


def test_the_page_that_is_drawn_holds_the_figures_and_plotly(fake, tmp_path: Path) -> None:
    fake(f'cp "$(echo $page | sed "s,file://,,;s/#all//")" {tmp_path}/drawn.html\n' + drawing("one"))
    write_figures(tmp_path / "png", {"one": {"data": [{"x": [float("nan"), 2.5]}], "layout": {"height": 123}}})
    text = (tmp_path / "drawn.html").read_text()
    assert '"one":{"data":[{"x":[null,2.5]}],"layout":{"height":123}}' in text
    assert "width: 900" in text and "scale: 2" in text and "plotly.js v" in text


def test_key_figures_are_what_a_reader_needs_first() -> None:
    full, plain = report_page().joints
    found = key_figures(full)
    assert {"confidence", "ladder", "motor_torque_overlay", "motor_torque_orders", "transmission_overlay"} <= set(found)
    for channel in full.channels:
        first = next(iter(channel.models))
        assert (f"{channel.name}_map" in found) == (dependence(channel.maps[first]) is not None)
        assert (f"{channel.name}_orders" in found) == bool(channel.spectra[first][1])
    assert "confidence" not in key_figures(plain) and "ladder" not in key_figures(plain)
    twice = JointPage(full.joint, full.channels, full.diagnosis, full.ladders * 2)
    assert {"ladder_1", "ladder_2"} <= set(key_figures(twice)) and "ladder" not in key_figures(twice)


def test_pictures_of_a_report_are_named_after_joint_and_figure(fake, tmp_path: Path) -> None:
    page = report_page(("joint_1", "joint_2"))
    names = [f"{joint.joint}_{what}" for joint in page.joints for what in key_figures(joint)]
    fake(drawing(*names))
    paths = write_pictures(tmp_path / "png", page)
    assert sorted(path.stem for path in paths) == sorted(names)
