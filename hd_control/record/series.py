"""Any series of numbers as a bag for plotting tools, one topic each, with a layout for Foxglove and for PlotJuggler.

The messages are std_msgs/Float64 whose log time is the time of the sample. Both tools draw against the log time by
default and know such a topic as one curve under one name (`/name.data`, `/name/data`) in every version; the curves of
a JointState are named differently by version, and its fields would have to carry what they are not made for.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hd_control.core.errors import BagError
from hd_control.record.cdr import NUMBER, NumberCodec
from hd_control.record.whole_output import whole_bag, whole_file
from hd_control.record.writer import BagWriter

Series = Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
"""Topic name -> (stamps in ns, values), each (n,)."""
Pages = Mapping[str, Sequence[Sequence[str]]]
"""Title of a page -> its plots, from above to below -> topic names drawn together."""
FOXGLOVE, PLOTJUGGLER = ".foxglove.json", ".plotjuggler.xml"
COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")


def topic_name(*parts: str) -> str:
    """A ROS topic name of some words: letters, digits and underscores between slashes."""
    words = (re.sub(r"[^A-Za-z0-9_]", "_", part) for part in parts)
    return "/".join(word if not word[:1].isdigit() else f"_{word}" for word in words)


def write_series_bag(
    path: str | Path, series: Series, force: bool = False, metadata: Mapping[str, str] | None = None
) -> Path:
    """Writes a bag, whole or not at all; values that are not finite are left out. Raises BagError."""
    if not series:
        raise BagError(f"{path}: there is no series to write")
    path = Path(path)
    with whole_bag(path, force) as place, BagWriter(place, live=False, metadata=metadata) as writer:
        for name, (stamps, values) in series.items():
            finite = np.isfinite(values)
            writer.add_topic(name, NUMBER, period_ns=0)
            writer.write_columns(name, NumberCodec(), np.asarray(stamps)[finite], data=values[finite][:, None])
        writer.close()
    return path


def layout_paths(bag: str | Path) -> list[Path]:
    """Where the layouts of Foxglove and PlotJuggler lie: beside the bag, named after it."""
    bag = Path(bag)
    return [bag.with_name(bag.name + ending) for ending in (FOXGLOVE, PLOTJUGGLER)]


def write_layouts(bag: str | Path, pages: Pages, force: bool = False) -> list[Path]:
    """Writes the layouts beside the bag and returns their paths. Raises BagError if one exists without `force`."""
    paths = layout_paths(bag)
    for path in paths:
        if path.exists() and not force:
            raise BagError(f"{path}: exists already; choose another name or add --force")
    for path, text in zip(paths, (foxglove_layout(pages), plotjuggler_layout(pages)), strict=True):
        with whole_file(path) as place:
            place.write_text(text, encoding="utf-8")
    return paths


def foxglove_layout(pages: Pages) -> str:
    """JSON that Foxglove opens by "Import from file": one tab per page, the plots below each other."""
    panels: dict[str, Any] = {}
    tabs = []
    for title, plots in pages.items():
        names: list[str] = []
        for topics in plots:
            names.append(f"Plot!{topic_name(title)}_{len(names)}")
            panels[names[-1]] = _foxglove_plot(topics)
        tabs.append({"title": title, "layout": _column(names)})
    panels["Tab!pages"] = {"activeTabIdx": 0, "tabs": tabs}
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!pages",
    }
    return json.dumps(document, indent=1) + "\n"


def _foxglove_plot(topics: Sequence[str]) -> dict[str, Any]:
    paths = [
        {"value": f"/{name}.data", "enabled": True, "timestampMethod": "receiveTime", "color": color, "label": name}
        for name, color in zip(topics, _colors(len(topics)), strict=True)
    ]
    return {
        "paths": paths,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "top",
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _column(names: Sequence[str]) -> Any:
    """Panels below each other with equal heights."""
    if len(names) == 1:
        return names[0]
    share = 100.0 / len(names)
    return {"direction": "column", "first": names[0], "second": _column(names[1:]), "splitPercentage": share}


def plotjuggler_layout(pages: Pages) -> str:
    """XML that PlotJuggler opens by "Layout: load": one tab per page, the plots below each other."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for title, plots in pages.items():
        tab = ElementTree.SubElement(window, "Tab", tab_name=title, containers="1")
        container = ElementTree.SubElement(tab, "Container")
        sizes = ";".join([f"{1.0 / len(plots):.6f}"] * len(plots))
        splitter = ElementTree.SubElement(
            container, "DockSplitter", orientation="-", sizes=sizes, count=str(len(plots))
        )
        for topics in plots:
            area = ElementTree.SubElement(splitter, "DockArea", name="...")
            plot = ElementTree.SubElement(
                area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
            )
            ElementTree.SubElement(plot, "limitY")
            for name, color in zip(topics, _colors(len(topics)), strict=True):
                ElementTree.SubElement(plot, "curve", name=f"/{name}/data", color=color)
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root, " ")
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


def _colors(count: int) -> list[str]:
    return [COLORS[k % len(COLORS)] for k in range(count)]
