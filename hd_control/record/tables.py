"""Numbers of a recording in other files: tables (CSV, NPZ) in and out, and series as bags for plotting tools."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError
from hd_control.core.files import write_whole
from hd_control.record.bag_folder import whole_bag
from hd_control.record.cdr import NUMBER, NumberCodec
from hd_control.record.writer import BagWriter

# ---- Series for plotting tools: a bag with one topic each, and a layout for Foxglove and for PlotJuggler ----
#
# The messages are std_msgs/Float64 whose log time is the time of the sample. Both tools draw against the log time by
# default and know such a topic as one curve under one name (`/name.data`, `/name/data`) in every version; the curves of
# a JointState are named differently by version, and its fields would have to carry what they are not made for.


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
        write_whole(path, text, BagError)
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


# ---- Tables ----------------------------------------------------------------------------------------


NAMES = "joints"
"""Key of an NPZ file that holds the joint names."""
DELIMITERS = ",;\t"
ROWS_AT_ONCE = 20_000


def read_table(path: str | Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """(columns by name, joint names): CSV columns are (n,), NPZ arrays (n,) or (n, joints), float64.

    The joint names are empty if the file does not say them. Raises BagError with line or key for what is no table.
    """
    path = Path(path)
    if not path.is_file():
        raise BagError(f"{path}: no such file; give a .csv or .npz file")
    if path.suffix.lower() == ".npz":
        return _read_npz(path)
    if path.suffix.lower() in (".csv", ".tsv", ".txt"):
        return _read_csv(path), ()
    raise BagError(f"{path}: {path.suffix or 'a file without an ending'} is not read; give a .csv or .npz file")


def _read_npz(path: Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    found: dict[str, FloatArray] = {}
    names: tuple[str, ...] = ()
    try:
        with np.load(path, allow_pickle=False) as archive:
            for key in archive.files:
                array = archive[key]
                if key == NAMES and array.dtype.kind in "US":
                    names = tuple(str(name) for name in np.atleast_1d(array).astype(str))
                elif array.dtype.kind in "fiub" and array.ndim in (1, 2):
                    found[key] = array.astype(np.float64)
    except Exception as error:  # zipfile, numpy and zlib leak errors of their own
        raise BagError(f"{path}: not a readable NPZ file ({type(error).__name__}: {error})") from None
    if not found:
        raise BagError(f"{path}: no array of numbers with one or two dimensions")
    return found, names


def _read_csv(path: Path) -> dict[str, FloatArray]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header, delimiter, line = _header(stream, path)
            rows = csv.reader(stream, delimiter=delimiter)
            table = np.concatenate([np.empty((0, len(header))), *_blocks(rows, len(header), delimiter, path, line)])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BagError(f"{path}: not a readable CSV file ({error})") from None
    if not len(table):
        raise BagError(f"{path}: a header but no row of numbers")
    return {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(header)}


def _header(stream: Iterator[str], path: Path) -> tuple[list[str], str, int]:
    """Column names, delimiter and line number of the first line that is no comment."""
    for line, text in enumerate(stream, 1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        delimiter = max(DELIMITERS, key=text.count)
        names = [name.strip() for name in next(csv.reader([text.rstrip("\r\n")], delimiter=delimiter))]
        if any(_is_number(name) for name in names):
            raise BagError(f"{path}, line {line}: expected the names of the columns, got numbers; add a header line")
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise BagError(f"{path}, line {line}: two columns are named {twice!r}")
        return names, delimiter, line
    raise BagError(f"{path}: the file is empty")


def _blocks(rows: Iterator[list[str]], width: int, delimiter: str, path: Path, line: int) -> Iterator[FloatArray]:
    """The numbers, some thousand lines at a time; an empty cell is NaN."""
    while block := list(islice(rows, ROWS_AT_ONCE)):
        wrong = next((k for k, row in enumerate(block) if row and len(row) != width), None)
        if wrong is not None:
            raise BagError(f"{path}, line {line + wrong + 1}: {len(block[wrong])} cells, the header has {width}")
        kept = [row for row in block if row]
        try:
            yield np.array(kept, dtype=np.float64).reshape(-1, width)
        except ValueError:
            comma = delimiter != ","
            yield np.array(
                [[_cell(cell, comma, path, line + k + 1) for cell in row] for k, row in enumerate(block) if row]
            ).reshape(-1, width)
        line += len(block)


def _cell(text: str, comma: bool, path: Path, line: int) -> float:
    text = text.strip().replace(",", ".") if comma else text.strip()
    if not text:
        return float("nan")
    if not _is_number(text):
        raise BagError(f"{path}, line {line}: {text[:40]!r} is not a number")
    return float(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_csv(
    path: Path, columns: Mapping[str, FloatArray], progress: Callable[[float], None] = lambda share: None
) -> None:
    """Columns (n,) with a header line, 15 digits, an empty cell for NaN. `progress` is called with the share done."""
    count = len(next(iter(columns.values())))
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for begin in range(0, count, ROWS_AT_ONCE):
            part = np.column_stack([values[begin : begin + ROWS_AT_ONCE] for values in columns.values()])
            writer.writerows(["" if x != x else f"{x:.15g}" for x in row] for row in part.tolist())
            progress(min(1.0, (begin + ROWS_AT_ONCE) / count))


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Arrays under their names, compressed."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
