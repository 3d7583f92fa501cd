"""What a recording holds: topics, rates, gaps, drops, joints, possible residual channels, range of operation.

Topics are gone through block by block, so an hour fits in memory.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.errors import BagError
from hd_control.core.topics import JOINT_STATE_TYPE, Place, signal_places, topic_info
from hd_control.record.block import find_gaps, streams_of
from hd_control.record.columns import Columns, has_fixed_layout
from hd_control.record.reader import BagReader
from hd_control.record.writer import SESSION

# ---- Speeds of a joint: range, decades between fast and slow, reversals, without keeping every sample ----


STANDSTILL = 0.01
"""Below this share of the largest speed a joint counts as standing still."""
MOST_SAMPLES = 600_000
"""Samples kept for the percentiles: all of 10 min at 1 kHz, every k-th of more."""
PERCENTILES = (1, 99)


class SpeedScan:
    """Speeds of one joint. `rows`: how many will come, about; longer series are thinned for the percentiles only."""

    def __init__(self, rows: int) -> None:
        self._stride = max(1, -(-rows // MOST_SAMPLES))
        self._seen = 0
        self._low, self._high = np.inf, -np.inf
        self._samples: list[FloatArray] = []
        # Runs of equal sign, by their largest speed with its sign; those that can no longer count are dropped.
        self._runs: FloatArray = np.zeros(0)

    def add(self, speeds: FloatArray) -> None:
        """The next speeds, (n,); those that are not finite are left out."""
        speeds = speeds[np.isfinite(speeds)]
        if len(speeds) == 0:
            return
        self._samples.append(np.abs(speeds[-self._seen % self._stride :: self._stride]))
        self._seen += len(speeds)
        self._low, self._high = min(self._low, float(speeds.min())), max(self._high, float(speeds.max()))
        signs = np.sign(speeds)
        starts = np.concatenate([[0], np.flatnonzero(np.diff(signs)) + 1])
        runs = np.concatenate([self._runs, np.maximum.reduceat(np.abs(speeds), starts) * signs[starts]])
        self._runs = runs[np.abs(runs) > STANDSTILL * self._largest]

    @property
    def _largest(self) -> float:
        return max(self._high, -self._low)

    def result(self) -> dict[str, Any] | None:
        """Range, decades while moving and reversals; None without any speed."""
        if self._seen == 0:
            return None
        samples = np.concatenate(self._samples)
        moving = samples[samples > STANDSTILL * self._largest]
        slow, fast = np.percentile(moving, PERCENTILES) if len(moving) else (1.0, 1.0)
        return {
            "low": self._low,
            "high": self._high,
            "unit": "rad/s",
            "decades": float(np.log10(fast / slow)),
            "reversals": int((np.diff(np.sign(self._runs)) != 0).sum()),
        }


# ---- One topic: stamps, streams, ranges of every field and joint -----------------------------------


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


# ---- The summary -----------------------------------------------------------------------------------


SCHEMA = "hd.info/1"
Sources = dict[str, tuple[TopicScan, Range]]
"""Where each signal of a joint comes from, and its range."""
SHOWN_GAPS = 20

# Signal as `hd info` names it: where it may come from, the first that is there counts.
SIGNALS: dict[str, tuple[Place, ...]] = {
    word: signal_places()[signal]
    for word, signal in {
        "motor_shaft_position": "motor_shaft_position",
        "joint_position": "joint_position",
        "joint_velocity": "joint_velocity",
        "joint_torque": "gauge_torque",
        "motor_torque": "motor_torque",
        "motor_temperature": "temperature",
        "desired_position": "reference_position",
    }.items()
}


def possible_channels(signals: Collection[str]) -> dict[str, str]:
    """The residual channels that the signals of one joint allow, each with what it rests on."""
    rotor, joint, torque, motor = (
        name in signals for name in ("motor_shaft_position", "joint_position", "joint_torque", "motor_torque")
    )
    found = {}
    if rotor and torque and motor:
        found["motor_torque"] = "measured"
    elif motor and (joint or rotor):
        found["motor_torque"] = "load torque from the link model"
    if rotor and joint and (torque or motor):
        found["transmission"] = "measured" if torque else "torque from the link model"
    if joint and torque:
        found["link_torque"] = "measured"
    elif rotor and torque:
        found["link_torque"] = "rotor angle for joint angle, below a third of the joint resonance"
    return found


def summarize(bag: BagReader) -> dict[str, Any]:
    """The document of `hd info --json`. The recording is gone through block by block."""
    scans: dict[str, TopicScan] = {}
    topics = {name: _topic(bag, name, scans) for name in sorted(bag.topics)}
    joints = _joints(bag, scans)
    times = [time for scan in scans.values() if scan.count for time in (scan.first_ns, scan.last_ns)]
    return {
        "schema": SCHEMA,
        "bag": str(bag.path),
        "complete": bag.complete,
        "problems": [str(problem) for problem in bag.problems],
        "messages": sum(bag.counts.values()),
        "duration": (max(times) - min(times)) * 1e-9 if times else 0.0,
        "topics": topics,
        "joints": joints,
        "attachments": {name: len(data) for name, data in bag.attachments.items()},
        "session": bag.metadata.get(SESSION, {}),
    }


def _topic(bag: BagReader, name: str, kept: dict[str, TopicScan]) -> dict[str, Any]:
    """Counts, rate and holes of one topic; its scan goes to `kept`, under the plain name if the schema knows it."""
    known = topic_info(name)
    row: dict[str, Any] = {
        "type": bag.topics[name],
        "messages": bag.counts[name],
        "rate": None,
        "gaps": None,
        "missing": None,
        "drops": bag.accounting.get(name, {}).get("drops"),
        "never_published": bag.accounting.get(name, {}).get("never_published"),
    }
    if not bag.counts[name] or not has_fixed_layout(bag.topics[name]):
        return row
    plain = name if known is None else known.name
    scan, stamps, streams = scan_topic(bag, name, (plain, "velocity") in SIGNALS["joint_velocity"])
    kept.setdefault(plain, scan)
    row["rate"] = 1e9 / scan.step_ns if scan.step_ns else None
    period = _period_ns(known.period_ns if known else 0, int(scan.step_ns))
    if period and bag.topics[name] == JOINT_STATE_TYPE:
        gaps = find_gaps(stamps, streams_of(streams), period)
        row["gaps"], row["missing"] = len(gaps), sum(gap.missing for gap in gaps)
        row["first_gaps"] = [[gap.from_ns, gap.to_ns, gap.missing] for gap in gaps[:SHOWN_GAPS]]
    steps = np.diff(stamps)
    row["out_of_order"], row["duplicates"] = int((steps < 0).sum()), int((steps == 0).sum())
    if known is not None and known.name == "motor_temperature":
        row["duplicates"] = 0  # joints share the stamp
    return row


def _period_ns(nominal: int, median: int) -> int:
    """The nominal period unless the topic is a slower robot's; 0 if neither is known."""
    return median if median > 1.5 * nominal else nominal


def _source(scans: dict[str, TopicScan], joint: str, signal: str) -> tuple[TopicScan, Range] | None:
    """The first topic that has the signal of the joint with any finite value, and its range."""
    for topic, name in SIGNALS[signal]:
        found = scans.get(topic)
        if found is not None and found.has(joint, name):
            return found, found.ranges[name, joint]
    return None


def _joints(bag: BagReader, scans: dict[str, TopicScan]) -> dict[str, Any]:
    ours = [scan for topic, scan in scans.items() if topic_info(topic) and "introspection" not in topic]
    sources = {
        joint: {signal: found for signal in SIGNALS if (found := _source(scans, joint, signal)) is not None}
        for joint in dict.fromkeys(name for scan in ours for name in scan.names)
    }
    speeds = _speeds(bag, sources)
    return {
        joint: {
            "signals": {signal: _plain_name(scan.topic) for signal, (scan, _) in series.items()},
            "channels": possible_channels(series.keys()),
            "coverage": _coverage(series, speeds.get(joint)),
        }
        for joint, series in sources.items()
    }


def _plain_name(topic: str) -> str:
    known = topic_info(topic)
    return topic if known is None else known.name


def _speeds(bag: BagReader, sources: dict[str, Sources]) -> dict[str, SpeedScan]:
    """Recorded speeds; for joints without them those of their angle, each topic read once more."""
    found: dict[str, SpeedScan] = {}
    angles: dict[str, tuple[TopicScan, list[str]]] = {}
    for joint, series in sources.items():
        if "joint_velocity" in series:
            found[joint] = series["joint_velocity"][0].speeds[joint]
        elif "joint_position" in series:
            scan = series["joint_position"][0]
            angles.setdefault(scan.topic, (scan, []))[1].append(joint)
    for scan, joints in angles.values():
        found |= speeds_from_angles(bag, scan, joints)
    return found


def _coverage(series: Sources, speed: SpeedScan | None) -> dict[str, Any]:
    """Ranges of speed, load, angle and temperature of one joint; only what its signals show."""
    found: dict[str, Any] = {}
    for signal, name, unit in (
        ("joint_position", "angle", "rad"),
        ("joint_torque", "load", "N·m"),
        ("motor_temperature", "temperature", "°C"),
    ):
        if signal in series:
            _, values = series[signal]
            found[name] = {"low": values.low, "high": values.high, "unit": unit}
    if "motor_shaft_position" in series:
        _, angle = series["motor_shaft_position"]
        found["wave_generator_turns"] = (angle.high - angle.low) / (2 * np.pi)
    moved = speed.result() if speed is not None else None
    if moved is not None:
        found["speed"] = moved
    return found


def open_and_summarize(path: str) -> dict[str, Any]:
    """Opens a recording and describes it. Raises BagError if there is nothing to describe."""
    bag = BagReader(path)
    document = summarize(bag)
    if not bag.topics and bag.complete:
        raise BagError(f"{path}: the recording is whole but has no topics")
    return document
