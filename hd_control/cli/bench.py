"""`hd bench`: speed of every hot path, beside peers measured in the same run."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_control.bench.growth import Point
    from hd_control.bench.measure import Result

NAME = "bench"
HELP = "speed of every hot path, beside peers"
EXAMPLE = """hd bench --only plant laws --runs 20
  hd bench --growth --png pictures --json bench.json"""
SCHEMA = "hd.bench/1"
CURVES = ("decoding", "replay", "joints", "length", "rate", "ring")
GROUPS = ("plant", "laws", "runner", "records", "replay", "start", "workbench", "lockstep", "ring", "robot", "recorder")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("--only", nargs="*", choices=GROUPS, default=list(GROUPS), help="groups to run [all]")
    parser.add_argument("--runs", type=int, default=15, help="runs of each short measurement [15]")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of each live run [10]")
    parser.add_argument("--load", action="store_true", help="live nodes also beside programs that keep it busy")
    parser.add_argument(
        "--growth",
        nargs="*",
        metavar="CURVE",
        choices=CURVES,
        help=f"also the curves {', '.join(CURVES)} [all]; takes minutes",
    )
    parser.add_argument("--update", action="store_true", help="keep what --json FILE has and this run does not measure")
    parser.add_argument("--png", metavar="DIR", help="draw the curves; needs a browser")


def run(arguments: argparse.Namespace) -> int:
    """Measures and prints the table. What cannot be measured becomes a note; an interrupted run keeps what it has."""
    from hd_control.bench.measure import machine
    from hd_control.cli.options import say, write_json
    from hd_control.core.errors import ConfigError

    if arguments.runs < 1 or not arguments.seconds > 0.0:
        raise ConfigError(f"--runs {arguments.runs}, --seconds {arguments.seconds:g}: both must be positive")
    about, kept = machine(), _stored(arguments)
    say(arguments, "machine: " + ", ".join(f"{key} {value}" for key, value in about.items()))
    results: list[Result] = []
    points: list[Point] = []
    notes: list[str] = []
    try:
        _rows(arguments, results, notes)
        if arguments.growth is not None:
            _growth(arguments, points, notes)
    finally:
        for note in notes:
            say(arguments, f"note: {note}")
        document: dict[str, Any] = {"schema": SCHEMA, "machine": about, "results": [row.as_json() for row in results]}
        document |= {"growth": [point.as_json() for point in points], "notes": notes}
        write_json(arguments, merged(kept, document) if kept else document)
    if arguments.png:
        _draw(arguments, merged(kept, document)["growth"] if kept else document["growth"])
    return 0


def _stored(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """The document of an earlier run, with `--update`. Raises HdError if the file is none."""
    import json
    from pathlib import Path

    from hd_control.core.errors import HdError

    if not arguments.update or arguments.json in (None, "-") or not Path(arguments.json).exists():
        return None
    try:
        found: dict[str, Any] = json.loads(Path(arguments.json).read_text(encoding="utf-8"))
    except ValueError as error:
        raise HdError(f"{arguments.json}: no JSON ({error})") from None
    if found.get("schema") != SCHEMA:
        raise HdError(f"{arguments.json}: not a document of {SCHEMA}; choose another --json FILE")
    return found


def merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The new run, and of the old one the rows and curves that the new one does not have; a note names them."""
    rows, points = ({entry["name"] for entry in new[kind]} for kind in ("results", "growth"))
    kept_rows = [row for row in old["results"] if row["name"] not in rows]
    kept_points = [point for point in old["growth"] if point["name"] not in points]
    names = list(dict.fromkeys(entry["name"] for entry in (*kept_rows, *kept_points)))
    return {
        **new,
        "results": kept_rows + new["results"],
        "growth": kept_points + new["growth"],
        "notes": [*_kept_notes(old, names), *new["notes"]],
    }


def _kept_notes(old: dict[str, Any], names: list[str]) -> list[str]:
    """Of which run the rows and curves are that stay: what earlier notes say of them, else the old run's own load."""
    found, named, mark = [], set[str](), ": from an earlier run"
    for note in old["notes"]:
        listed, marked, load = note.partition(mark)
        left = [name for name in listed.split(", ") if name in names] if marked else []
        found += [f"{', '.join(left)}{mark}{load}"] if left else []
        named |= set(left)
    own = [name for name in names if name not in named]
    return [*found, *([f"{', '.join(own)}{mark}, load {old['machine']['load']}"] if own else [])]


def _rows(arguments: argparse.Namespace, results: list[Result], notes: list[str]) -> None:
    """Adds the rows of the groups that were asked for."""
    from hd_control.cli.options import say
    from hd_control.core.errors import HdError

    groups = _groups(arguments)
    for name in (name for name in GROUPS if name in arguments.only):
        try:
            rows, remarks = groups[name]()
        except HdError as error:
            rows, remarks = [], [f"{name}: not measured, {error}"]
        results += rows
        notes += remarks
        for line in lines(rows):
            say(arguments, line)


def _growth(arguments: argparse.Namespace, found: list[Point], notes: list[str]) -> None:
    """Adds the points of the curves, and draws them."""
    from hd_control.bench.growth import growth_points
    from hd_control.cli.options import say

    for point in growth_points(arguments.growth or CURVES, arguments.seconds, notes):
        found.append(point)
        say(arguments, f"{point.name:26}{point.size:>10g} {point.axis:<9}{point.value:>12.4g}  {point.unit}")


def _draw(arguments: argparse.Namespace, points: list[dict[str, Any]]) -> None:
    """The curves as a picture."""
    from hd_control.bench.growth import growth_figure
    from hd_control.cli.options import say
    from hd_control.lab.page.pictures import write_figures

    for path in write_figures(arguments.png, {"bench_growth": growth_figure(points)}, arguments.force):
        say(arguments, f"written: {path}")


def _groups(arguments: argparse.Namespace) -> dict[str, Callable[[], tuple[list[Result], list[str]]]]:
    """What each group measures: its rows, and remarks."""
    from hd_control.bench import commands, rows

    runs = arguments.runs
    few = max(1, runs // 5)
    return {
        "plant": lambda: rows.plant_rows(runs),
        "laws": lambda: (rows.law_rows(runs), []),
        "runner": lambda: (rows.lockstep_row(few), []),
        "records": lambda: (rows.decode_rows(few), []),
        "replay": lambda: (rows.replay_rows(few), []),
        "workbench": lambda: (commands.workbench_rows(few), []),
        "start": lambda: (rows.start_rows(runs), []),
        "lockstep": lambda: (rows.lockstep_rows(few), []),
        "ring": lambda: (rows.ring_rows(few, arguments.seconds), []),
        "robot": lambda: (rows.robot_rows(few, arguments.seconds, arguments.load), []),
        "recorder": lambda: (rows.recorder_rows(few, arguments.seconds), []),
    }


def lines(rows: list[Result]) -> Iterator[str]:
    """Rows as text: median, minimum, 99th percentile, and for a peer how many times slower than ours it is."""
    ours = {row.name: row.median for row in rows if row.peer is None}
    for row in rows:
        label = row.name if row.peer is None else f"  {row.peer}"
        ratio = ""
        if row.peer is not None and ours.get(row.name) and row.median > 0.0:
            ratio = f"   {row.median / ours[row.name]:.3g} x"
        cells = ("-" if math.isnan(value) else f"{value:.4g}" for value in (row.median, row.min, row.p99))
        yield f"{label:26}" + "".join(f"{cell:>12}" for cell in cells) + f"  {row.unit}{ratio}"
