"""PNG files of the key figures of a report, all drawn in one run of an installed browser without a window."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_control.core.errors import HdError
from hd_control.core.files import refusal, write_whole
from hd_control.lab.maps.condition_maps import dependence
from hd_control.lab.page.measured_figures import friction_figure
from hd_control.lab.page.model_figures import confidence_figure, ladder_figure, overlay_figure
from hd_control.lab.page.page import json_text
from hd_control.lab.page.page_data import JointPage, ReportPage
from hd_control.lab.page.residual_figures import map_figure, order_figure
from hd_control.lab.page.style import Figure
from hd_control.lab.page.words import confidence_bars

# ---- The browser -----------------------------------------------------------------------------------


NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
TIMEOUT_S = 120.0
BUDGET_MS = 20_000
"""Virtual time of a page: its timers run through at once, however slow the machine is."""


def find_browser() -> str | None:
    """Path of a browser of the Chromium family: $HD_BROWSER, else the first of `NAMES`; None if there is none."""
    named = os.environ.get("HD_BROWSER")
    if named:
        return shutil.which(named)
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def browser() -> str:
    """As `find_browser`. Raises HdError with the remedy if there is none."""
    found = find_browser()
    if found is None:
        raise HdError(
            "no browser for pictures; install chromium, or name one in HD_BROWSER; the page itself needs none"
        )
    return found


@dataclass(frozen=True)
class Look:
    """A page after its scripts: its text, what it wrote to the console, addresses that it asked for."""

    html: str
    console: tuple[str, ...]
    requests: tuple[str, ...]


def screenshot(page: Path, picture: Path, width: int = 1200, height: int = 900, everything: bool = True) -> Path:
    """A PNG of a page, `everything` of it drawn. Raises HdError without a browser or picture."""
    address = page.resolve().as_uri() + ("#all" if everything else "")
    options = [f"--window-size={width},{height}", f"--screenshot={picture.resolve()}"]
    _run(address, *options)
    if not picture.is_file() or picture.stat().st_size == 0:
        raise HdError(f"{picture}: the browser drew no picture")
    return picture


def look(page: Path, width: int = 1200, height: int = 900, everything: bool = True) -> Look:
    """Opens a page and reports what happened. Raises HdError without a browser."""
    import json

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "net.json"
        address = page.resolve().as_uri() + ("#all" if everything else "")
        options = [f"--window-size={width},{height}", "--dump-dom", "--enable-logging=stderr", f"--log-net-log={log}"]
        done = _run(address, *options)
        console = re.findall(r"CONSOLE[^\]]*\] (.*)", done.stderr)
        events = json.loads(log.read_text()).get("events", []) if log.is_file() else []
    asked = {str(event["params"]["url"]) for event in events if _by_page(event.get("params", {}))}
    asked -= {address, page.resolve().as_uri()}
    local = ("data:", "blob:", "chrome:", "chrome-extension:", "about:")
    return Look(done.stdout, tuple(console), tuple(sorted(url for url in asked if not url.startswith(local))))


def _by_page(event: Mapping[str, Any]) -> bool:
    """Was an address asked for by the page, and not by the browser for itself?"""
    return "url" in event and event.get("initiator", "not an origin") != "not an origin"


def _run(address: str, *options: str) -> subprocess.CompletedProcess[str]:
    """One run of the browser with a profile of its own and no connection of its own accord."""
    with tempfile.TemporaryDirectory() as profile:
        command = [browser(), "--headless=new", "--disable-gpu", "--hide-scrollbars", "--no-first-run"]
        command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
        command += ["--disable-dev-shm-usage", "--force-device-scale-factor=1", f"--user-data-dir={profile}"]
        command += ["--disable-features=OptimizationHints,MediaRouter,Translate", "--disable-default-apps"]
        command += [f"--virtual-time-budget={BUDGET_MS}", *options, address]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # the sandbox refuses to run as root
        try:
            return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, errors="replace")
        except subprocess.TimeoutExpired:
            raise HdError(f"the browser did not finish {address} within {TIMEOUT_S:g} s") from None
        except OSError as error:
            raise HdError(f"{command[0]}: cannot be started ({error.strerror})") from None


# ---- The key figures -------------------------------------------------------------------------------


WIDTH, SCALE = 900, 2
"""Pixels of a picture before scaling; the file has `SCALE` times as many."""
_DRAW = """
(async () => {
  for (const [name, figure] of Object.entries(FIGURES)) {
    const size = { format: "png", width: WIDTH, height: figure.layout.height, scale: SCALE };
    const place = document.createElement("pre");
    place.id = name;
    place.textContent = await Plotly.toImage(figure, size);
    document.body.append(place);
  }
})();
"""


def write_pictures(folder: str | Path, page: ReportPage, force: bool = False) -> list[Path]:
    """The key figures of all joints as FOLDER/JOINT_WHAT.png. Raises HdError without a browser, or if a file exists
    and `force` is not given."""
    figures = {f"{joint.joint}_{what}": figure for joint in page.joints for what, figure in key_figures(joint).items()}
    return write_figures(folder, figures, force)


def key_figures(joint: JointPage) -> dict[str, Figure]:
    """What a reader needs first, by name: answer, ladder, friction, lines; per channel overlay, best map, orders."""
    found: dict[str, Figure] = {}
    bars = confidence_bars(joint.diagnosis) if joint.diagnosis is not None else []
    if bars:
        found["confidence"] = confidence_figure(bars)
    for i, ladder in enumerate(joint.ladders):
        name = "ladder" if len(joint.ladders) == 1 else f"ladder_{i + 1}"
        found[name] = ladder_figure(ladder.rungs, ladder.unit, ladder.stopped_because)
    for curve in joint.observations.friction if joint.observations is not None else ():
        found[f"friction_{curve.signal}"] = friction_figure(curve)
    for item in joint.observations.spectra if joint.observations is not None else ():
        if item.lines:
            title = f"Order spectrum of the {item.signal.replace('_', ' ')} itself"
            found[f"orders_{item.signal}"] = order_figure(item.orders, item.lines, item.unit, title)
    for channel in joint.channels:
        first = next(iter(channel.models))
        unit = channel.models[first].unit
        found[f"{channel.name}_overlay"] = overlay_figure(channel.models)
        shown = dependence(channel.maps[first])
        if shown is not None:
            found[f"{channel.name}_map"] = map_figure({first: shown}, unit)
        spectrum, lines = channel.spectra[first]
        if lines:
            found[f"{channel.name}_orders"] = order_figure(spectrum, lines, unit)
    return found


def write_figures(folder: str | Path, figures: Mapping[str, Figure], force: bool = False) -> list[Path]:
    """Figures (name -> figure) as FOLDER/NAME.png."""
    from plotly.offline import get_plotlyjs

    folder = Path(folder)
    paths = {name: folder / f"{re.sub('[^A-Za-z0-9_.-]', '_', name)}.png" for name in figures}
    for path in paths.values():
        if path.exists() and not force:
            raise HdError(f"{path}: exists already; choose another folder or add --force")
    script = _DRAW.replace("WIDTH", str(WIDTH)).replace("SCALE", str(SCALE))
    script = script.replace("FIGURES", json_text(dict(figures)))
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "figures.html"
        file.write_text(
            f'<!DOCTYPE html><html><head><meta charset="utf-8"></head><body><script>{get_plotlyjs()}</script>'
            f"<script>{script}</script></body></html>",
            encoding="utf-8",
        )
        drawn = dict(re.findall(r'<pre id="([^"]*)">data:image/png;base64,([^<]*)</pre>', look(file).html))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HdError(f"{folder}: {refusal(error)}") from None
    for name, path in paths.items():
        if name not in drawn:
            raise HdError(f"{path}: the browser drew no picture of {json.dumps(name)}")
        write_whole(path, base64.b64decode(drawn[name]))
    return list(paths.values())
