"""How the figures of `hd bench` grow with joints, rate and length of a recording, as points and as one picture.

Each point is one figure measured at one size; `growth_figure` draws them, both axes logarithmic.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.bench.commands import make_puzzle, run_hd
from hd_control.bench.measure import Timed, time_each
from hd_control.bench.rows import TOPIC, bag_of, replay_cost
from hd_control.core.errors import HdError
from hd_control.lab.page.style import COLOURS, Figure, axis, layout
from hd_control.record.reader import BagReader

JOINTS, RATES, SECONDS = (1, 2, 4, 7), (125, 250, 500, 1000), (7.5, 15.0, 30.0, 60.0)
MESSAGES, RING_RATES = (2_000, 8_000, 32_000, 128_000), (250, 500, 1000, 2000)


@dataclass(frozen=True)
class Point:
    """One measured value: `name` at `size` of `axis` (joints, Hz, s or messages), in `unit`."""

    name: str
    axis: str
    size: float
    value: float
    unit: str

    def as_json(self) -> dict[str, Any]:
        """The entry of `growth` in the schema `hd.bench/1`."""
        return asdict(self)


def growth_points(curves: Sequence[str], seconds: float, notes: list[str]) -> Iterator[Point]:
    """Some curves; `seconds` is the length of each live run. Takes minutes. `notes` gets what could not be measured."""
    makers: dict[str, Callable[[], Iterator[Point]]] = {
        "decoding": _decoding,
        "replay": _replay,
        "joints": _commands_over_joints,
        "length": _commands_over_length,
        "rate": _commands_over_rate,
        "ring": lambda: _ring_over_rate(seconds, notes),
    }
    for name in curves:
        yield from makers[name]()


def _decoding() -> Iterator[Point]:
    """Reading one topic: us per message over joints, ms over the number of messages."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        for joints in (1, 7, 28):
            path = bag_of(Path(folder) / f"joints_{joints}", joints, 32_000)
            yield Point("decode_message", "joints", joints, _read_time(path) / 32_000 * 1e6, "us")
        for messages in MESSAGES:
            path = bag_of(Path(folder) / f"messages_{messages}", 7, messages)
            yield Point("read_topic", "messages", messages, _read_time(path) * 1e3, "ms")


def _read_time(path: Path) -> float:
    """Median s of five readings."""

    def read() -> None:
        with BagReader(path) as bag:
            bag.columns(TOPIC)

    return time_each("", "s", [Timed(read, 1)], 5, scale=1.0)[0].median


def _replay() -> Iterator[Point]:
    for plant, joints in (("single_joint_3", 1), ("arm_a", 7)):
        cost = float(np.median(replay_cost(plant, 3)))
        yield Point("replay_tick", "joints", joints, cost * joints * 1e-3, "us CPU")


def _commands_over_joints() -> Iterator[Point]:
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        bag, model = make_puzzle(Path(folder), "--arm")
        for joints in JOINTS:
            chosen = [word for number in range(1, joints + 1) for word in ("--joint", f"joint_{number}")]
            usage = run_hd("compare", bag, "--model", model, "--quiet", "--seconds", "20", *chosen)
            yield Point("compare_arm_20s", "joints", joints, usage.cpu, "CPU s")
            yield Point("compare_arm_20s_memory", "joints", joints, usage.memory, "MB")


def _commands_over_length() -> Iterator[Point]:
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        bag, model = make_puzzle(Path(folder))
        for length in SECONDS:
            for command in ("compare", "diagnose"):
                usage = run_hd(command, bag, "--model", model, "--quiet", "--seconds", str(length))
                yield Point(f"{command}_joint", "s", length, usage.cpu, "CPU s")


def _commands_over_rate() -> Iterator[Point]:
    """The same minute, every k-th sample of it."""
    with tempfile.TemporaryDirectory(prefix="hd_bench_") as folder:
        bag, model = make_puzzle(Path(folder))
        table = Path(folder) / "table.npz"
        run_hd("export", bag, "-o", str(table), "--quiet")
        with np.load(table, allow_pickle=False) as arrays:
            whole = {name: arrays[name] for name in arrays.files}
        for rate in RATES:
            thin = {name: column if name == "joints" else column[:: 1000 // rate] for name, column in whole.items()}
            np.savez(Path(folder) / f"{rate}.npz", **thin)
            made = str(Path(folder) / f"bag_{rate}")
            run_hd("import", str(Path(folder) / f"{rate}.npz"), "-o", made, "--quiet")
            for command in ("compare", "diagnose"):
                usage = run_hd(command, made, "--model", model, "--quiet")
                yield Point(f"{command}_minute", "Hz", rate, usage.cpu, "CPU s")


def _ring_over_rate(seconds: float, notes: list[str]) -> Iterator[Point]:
    from hd_control.bench.ring import ring

    for rate in RING_RATES:
        try:
            result = ring(seconds, 1.0 / rate)
        except HdError as error:
            notes.append(f"ring at {rate} Hz: not measured, {error}")
            continue
        yield Point("ring_missed", "Hz", rate, result.missed_percent, "%")
        yield Point("ring_p50", "Hz", rate, result.p50, "us")


# ---- The picture: a field for each axis ------------------------------------------------------------


FIELDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("joints", ("decode_message", "replay_tick", "compare_arm_20s")),
    ("messages", ("read_topic",)),
    ("s of recording", ("compare_joint", "diagnose_joint")),
    ("Hz", ("compare_minute", "diagnose_minute", "ring_missed", "ring_p50")),
)
"""Axis -> curves that are drawn over it."""


def growth_figure(points: Sequence[Mapping[str, Any]]) -> Figure:
    """Each curve over its smallest value, so that a slope can be read: 1 on the vertical axis is the first point."""
    data: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    measured = {point["name"] for point in points}
    fields = [(title, names) for title, names in FIELDS if measured & set(names)]
    for number, (title, names) in enumerate(fields, 1):
        suffix = "" if number == 1 else str(number)
        left = (number - 1) / len(fields) + (0.03 if number > 1 else 0.0)
        more[f"xaxis{suffix}"] = axis(title, type="log", domain=[left, number / len(fields) - 0.03], dtick="D2")
        more[f"yaxis{suffix}"] = axis("times the first value" if number == 1 else "", type="log", anchor=f"x{suffix}")
        for name in names:
            data += _curve(
                [point for point in points if point["name"] == name], suffix, COLOURS[len(data) % len(COLOURS)]
            )
    return {"data": data, "layout": layout("What more joints, longer and faster recordings cost", 460, **more)}


def _curve(points: Sequence[Mapping[str, Any]], suffix: str, colour: str) -> list[dict[str, Any]]:
    points = [point for point in points if point["value"] is not None and math.isfinite(point["value"])]
    if not points or not points[0]["value"]:
        return []
    first = points[0]
    return [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": [point["size"] for point in points],
            "y": [point["value"] / first["value"] for point in points],
            "name": f"{first['name']} ({first['value']:.3g} {first['unit']})",
            "xaxis": f"x{suffix}",
            "yaxis": f"y{suffix}",
            "line": {"color": colour},
        }
    ]
