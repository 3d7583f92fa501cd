"""One topic gone through block by block: stamps, streams, ranges of every field and joint; an hour fits in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.record.columns import Columns
from hd_control.record.reader import BagReader
from hd_control.record.speed_scan import SpeedScan

SPEED_WINDOW_NS = 20_000_000


@dataclass
class Range:
    """Smallest and largest number of a series, and whether any is finite."""

    low: float = np.inf
    high: float = -np.inf
    finite: bool = False


@dataclass
class TopicScan:
    """What a topic holds: `names` of the joints, `first_ns` and `last_ns`, `ranges` by field and joint.

    `step_ns` is the median distance of stamps that rise (0: none), `speeds` those of the field `velocity` by joint.
    """

    topic: str
    names: tuple[str, ...] = ()
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    step_ns: float = 0.0
    ranges: dict[tuple[str, str], Range] = field(default_factory=dict)
    speeds: dict[str, SpeedScan] = field(default_factory=dict)

    def has(self, joint: str, field_name: str) -> bool:
        """True if the joint has any finite number in the field."""
        found = self.ranges.get((field_name, joint))
        return found is not None and found.finite

    def add_values(self, columns: Columns, rows: int) -> None:
        """The numbers of one block; `rows` is the length of the whole topic, 0 if speeds are not wanted."""
        self.names = tuple(dict.fromkeys((*self.names, *columns.names)))
        for field_name, table in columns.values.items():
            lows = np.fmin.reduce(table, axis=0, initial=np.inf)
            highs = np.fmax.reduce(table, axis=0, initial=-np.inf)
            finite = np.asarray(np.isfinite(table).any(axis=0))
            for k, joint in enumerate(columns.names):
                found = self.ranges.setdefault((field_name, joint), Range())
                found.low, found.high = min(found.low, float(lows[k])), max(found.high, float(highs[k]))
                found.finite = found.finite or bool(finite[k])
                if field_name == "velocity" and rows:
                    self.speeds.setdefault(joint, SpeedScan(rows)).add(table[:, k])


def scan_topic(bag: BagReader, topic: str, with_speeds: bool) -> tuple[TopicScan, IntArray, NDArray[np.int32] | None]:
    """(what it holds, stamps (n,), number of the stream of each message or None), of a topic with a fixed layout."""
    scan, rows = TopicScan(topic), bag.counts[topic] if with_speeds else 0
    stamps: list[IntArray] = []
    streams: list[NDArray[np.int32]] = []
    numbers: dict[bytes, int] = {}
    for columns in bag.column_blocks(topic):
        stamps.append(columns.stamps_ns)
        keys, inverse = (
            (np.array([b""]), np.zeros(len(columns), np.int64))
            if columns.frame_ids is None
            else np.unique(columns.frame_ids, return_inverse=True)
        )
        known = np.array([numbers.setdefault(bytes(key), len(numbers)) for key in keys.tolist()], np.int32)
        streams.append(known[inverse] if len(known) else np.zeros(0, np.int32))
        scan.add_values(columns, rows)
    joined = np.concatenate(stamps) if stamps else np.zeros(0, np.int64)
    stamps.clear()
    scan.count = len(joined)
    if scan.count:
        scan.first_ns, scan.last_ns = int(joined.min()), int(joined.max())
    scan.step_ns = _median_step(joined)
    return scan, joined, np.concatenate(streams) if len(numbers) > 1 else None


def _median_step(stamps: IntArray) -> float:
    steps = np.diff(stamps)
    if bool((steps <= 0).any()):
        steps = steps[steps > 0]
    return float(np.median(steps, overwrite_input=True)) if len(steps) else 0.0


def speeds_from_angles(bag: BagReader, scan: TopicScan, joints: Sequence[str]) -> dict[str, SpeedScan]:
    """Speeds of some joints as difference quotients of the field `position`, by joint.

    The quotient is taken over `SPEED_WINDOW_NS`, long enough that quantisation does not dominate.
    """
    width = max(1, round(SPEED_WINDOW_NS / scan.step_ns)) if scan.step_ns else 1
    found = {joint: SpeedScan(scan.count) for joint in joints}
    for stamps, angles in _overlapping(bag, scan.topic, joints, width):
        time = (stamps[width:] - stamps[:-width]) * 1e-9
        for k, joint in enumerate(joints):
            speed: FloatArray = np.full(len(time), np.nan)
            np.divide(angles[width:, k] - angles[:-width, k], time, out=speed, where=time > 0)
            found[joint].add(speed)
    return found


def _overlapping(
    bag: BagReader, topic: str, joints: Sequence[str], width: int
) -> Iterator[tuple[IntArray, FloatArray]]:
    """Stamps (n,) and angles (n, joints), n > `width`, each block beginning with the last `width` rows before it."""
    stamps, angles = np.zeros(0, np.int64), np.zeros((0, len(joints)))
    for columns in bag.column_blocks(topic):
        table = np.full((len(columns), len(joints)), np.nan)
        for k, joint in enumerate(joints):
            if joint in columns.names and columns.position is not None:
                table[:, k] = columns.position[:, columns.names.index(joint)]
        stamps, angles = np.concatenate([stamps, columns.stamps_ns]), np.concatenate([angles, table])
        if len(stamps) > width:
            yield stamps, angles
            stamps, angles = stamps[-width:].copy(), angles[-width:].copy()
