"""`docs/reference/bench.md`: the figures of one run of `hd bench --growth --json docs/reference/bench.json`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hd_control.bench.growth_figure import FIELDS
from hd_control.reference.markdown import code, page, table

FILE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "bench.json"
PICTURE = FILE.parents[1] / "pictures" / "bench_growth.png"
COMMAND = "hd bench --growth --runs 5 --seconds 3 --png docs/pictures --json docs/reference/bench.json --force"
MEANINGS = {
    "plant_5_substeps": "plant, 7 joints, 5 substeps per ms",
    "plant_10_substeps": "the same, 10 substeps",
    "step_fusion": "one call of the law, 7 joints",
    "step_motion": "one call of the law",
    "step_torque": "one call of the law",
    "step_gate": "one call of the safety gate",
    "chain_compute": "one tick of fusion, motion, torque, gate, as a node calls them",
    "lockstep_pure": "chain and plant without ROS",
    "decode_messages": "a bag to columns, open and check-sums included",
    "replay_batch": "recorded sensors through the laws again",
    "cli_start": "`hd --help`",
    "compare_bag": "`hd compare`, one joint, 60 s at 1 kHz, whole command",
    "diagnose_joint": "`hd diagnose`, the same recording",
    "peak_memory_compare": "largest process of that `hd compare`",
    "lockstep_ros_ticks": "four processes in lock-step",
    "ring_p50": "four processes that copy seven numbers, 1 kHz: round trip",
    "ring_p99": "the same",
    "ring_missed": "the same: ticks not back in time",
    "robot_ring_p50": "the real nodes, 1 kHz: round trip",
    "robot_ring_p99": "the same",
    "robot_ring_missed": "the same: ticks not back in time",
    "one_process_p50": "`chain` with plant in one thread over the same topics",
}


def bench_page() -> str:
    """The page. Raises FileNotFoundError without the file of a run."""
    document = json.loads(FILE.read_text(encoding="utf-8"))
    machine = ", ".join(f"{key} {value}" for key, value in document["machine"].items())
    intro = [
        f"Measured by `{COMMAND}`,",
        "or in parts (`--only`, `--update`) where a note says so. What the figures mean: [speed](../bench.md). Compare",
        "ratios within one run: the machine is a virtual one, other programs ran beside, its line has the load.",
    ]
    names = {point["name"] for point in document["growth"]}
    missing = [name for _, curves in FIELDS for name in curves if name not in names]
    return page(
        "Figures of `hd bench`",
        "`docs/reference/bench.json`",
        intro,
        [f"Machine: {machine}."],
        ["## Rows"],
        table(["row", "median", "min", "p99", "unit", "beside", "what"], _rows(document["results"])),
        [f"- {note}" for note in document["notes"]],
        ["## Growth"],
        [f"![Cost over joints, length and rate, each curve over its first point](../pictures/{PICTURE.name})"]
        if PICTURE.is_file()
        else [],
        table(["figure", "over", "values", "unit"], _curves(document["growth"])),
        [f"Not in this run: {', '.join(map(code, missing))}."] if missing else [],
    )


def _rows(results: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    """One line per row of ours; peers of the same run beside it with their median and ratio."""
    for row in (row for row in results if row["peer"] is None):
        peers = [other for other in results if other["name"] == row["name"] and other["peer"] is not None]
        beside = "; ".join(f"{peer['peer']} {_number(peer['median'])}{_ratio(peer, row)}" for peer in peers)
        cells = [_number(row[key]) for key in ("median", "min", "p99")]
        yield [code(row["name"]), *cells, row["unit"], beside, MEANINGS.get(row["name"], "")]


def _ratio(peer: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    both = (peer["median"], row["median"])
    return f" ({both[0] / both[1]:.3g} ×)" if all(both) else ""


def _curves(points: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    for name in dict.fromkeys(point["name"] for point in points):
        curve = [point for point in points if point["name"] == name]
        values = ", ".join(f"{point['size']:g}: {_number(point['value'])}" for point in curve)
        yield [code(name), curve[0]["axis"], values, curve[0]["unit"]]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if abs(value) < 1e4 else f"{value:.4g}"
