"""How the figures grow with joints, rate and length of a recording: one figure at several sizes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.bench.commands import make_puzzle, run_hd
from hd_control.bench.measure import Timed, time_each
from hd_control.bench.records import TOPIC, bag_of
from hd_control.bench.replays import replay_cost
from hd_control.core.errors import HdError
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
    from hd_control.nodes.ring_bench import ring

    for rate in RING_RATES:
        try:
            result = ring(seconds, 1.0 / rate)
        except HdError as error:
            notes.append(f"ring at {rate} Hz: not measured, {error}")
            continue
        yield Point("ring_missed", "Hz", rate, result.missed_percent, "%")
        yield Point("ring_p50", "Hz", rate, result.p50, "us")
