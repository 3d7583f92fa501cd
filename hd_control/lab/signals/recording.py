"""Reads a recording for the analysis: every joint's signals on one even time base, and what is wrong with them.

    recording = read_recording("bags/run1")
    recording.joints["joint_3"].gauge_torque        # (n,) N m, NaN inside gaps
    recording.problems, recording.notes             # what could not be read; what was repaired

A short topic is read once, a long one a few columns at a time; the collector goes through the topics one by one, aligns
every joint's columns, and notes whatever is odd. Nothing but the bag (and the mapping) is opened; other files beside it
are not looked at.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.core.errors import BagError
from hd_control.lab.signals.joint_signals import (
    LONGEST_ROWS,
    SIGNALS,
    Grain,
    JointSignals,
    Recording,
    decimate,
    factor_of,
    grain_of,
)
from hd_control.lab.signals.sources import (
    AT_STAMPS,
    STANDARD,
    SignalSource,
    SourceMap,
    held_from_measured,
    load_mapping,
)
from hd_control.lab.signals.time_base import (
    NS,
    SLOWEST,
    Alignment,
    TimeBase,
    longest_stretch,
    one_clock,
    rising,
    time_base,
)
from hd_control.record.columns import Columns, has_fixed_layout
from hd_control.record.reader import BagReader
from hd_control.record.writer import SESSION

# ---- The columns of a topic ------------------------------------------------------------------------


MOST_VALUES = 8_000_000
"""Numbers of a long topic in memory at once."""


class TopicColumns(Protocol):
    """What the analysis asks of a topic: `names` of the joints, `stamps_ns` (n,), and columns by field and joint."""

    names: tuple[str, ...]
    stamps_ns: IntArray

    def log_times_ns(self) -> IntArray:
        """Times of recording, (n,)."""

    def has(self, field: str) -> bool:
        """True if any message has the field."""

    def column(self, field: str, name: str) -> FloatArray:
        """The numbers of one joint, (n,), NaN where a message does not have them."""

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """(n, names): where a number is finite."""


def open_topic(bag: BagReader, topic: str) -> TopicColumns:
    """The columns of a topic; those of more than `LONGEST_ROWS` messages are read from the bag when they are needed."""
    if bag.counts[bag.resolve(topic)] > LONGEST_ROWS:
        return LongTopic(bag, topic)
    return ShortTopic(bag.columns(topic))


class ShortTopic:
    """Everything in memory."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self.names, self.stamps_ns = columns.names, columns.stamps_ns

    def log_times_ns(self) -> IntArray:
        """See `TopicColumns`."""
        return self._columns.log_times_ns

    def has(self, field: str) -> bool:
        """See `TopicColumns`."""
        return field in self._columns.values

    def column(self, field: str, name: str) -> FloatArray:
        """See `TopicColumns`."""
        return self._columns.values[field][:, self.names.index(name)]

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """See `TopicColumns`."""
        table = self._columns.values[field][:, [self.names.index(name) for name in names]]
        return np.asarray(np.isfinite(table))


class LongTopic:
    """The stamps in memory; columns of some joints at a time, each group with one pass over the topic."""

    def __init__(self, bag: BagReader, topic: str) -> None:
        self._bag, self._topic = bag, topic
        stamps = np.empty(bag.counts[bag.resolve(topic)], np.int64)
        names: dict[str, None] = {}
        self._fields: set[str] = set()
        count = 0
        for block in bag.column_blocks(topic):
            stamps[count : count + len(block)] = block.stamps_ns
            count += len(block)
            names.update(dict.fromkeys(block.names))
            self._fields.update(block.values)
        self.names, self.stamps_ns = tuple(names), stamps[:count]
        self._group: tuple[str, tuple[str, ...], FloatArray] = ("", (), np.empty((0, 0)))

    def log_times_ns(self) -> IntArray:
        """See `TopicColumns`."""
        return np.concatenate([block.log_times_ns for block in self._bag.column_blocks(self._topic)])

    def has(self, field: str) -> bool:
        """See `TopicColumns`."""
        return field in self._fields

    def column(self, field: str, name: str) -> FloatArray:
        """See `TopicColumns`."""
        if self._group[0] != field or name not in self._group[1]:
            width = max(1, MOST_VALUES // max(1, len(self.stamps_ns)))
            first = self.names.index(name)
            group = self.names[first : first + width]
            self._group = ("", (), np.empty((0, 0)))  # the old one goes before the new one comes
            self._group = (field, group, self._table(field, group))
        values: FloatArray = self._group[2][self._group[1].index(name)]
        return values

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """See `TopicColumns`."""
        return np.concatenate(
            [np.isfinite(_values(block, field, names)).T for block in self._bag.column_blocks(self._topic)]
        )

    def _table(self, field: str, names: Sequence[str]) -> FloatArray:
        """(names, n)."""
        table, count = np.empty((len(names), len(self.stamps_ns))), 0
        for block in self._bag.column_blocks(self._topic):
            table[:, count : count + len(block)] = _values(block, field, names)
            count += len(block)
        return table


def _values(block: Columns, field: str, names: Sequence[str]) -> FloatArray:
    """(names, n), NaN where the block has no such column."""
    found = np.full((len(names), len(block)), np.nan)
    for row, name in enumerate(names):
        if field in block.values and name in block.names:
            found[row] = block.values[field][:, block.names.index(name)]
    return found


# ---- The collector ---------------------------------------------------------------------------------


Rows = IntArray | slice
MEASURED = SIGNALS[:4]
"""A row is valid if none of these is missing in it (of those that the joint has)."""
SLOW = ("temperature",)
OPTIONAL = ("temperature", "reference_position")
EMPTY = 0.02
"""A signal with a smaller share of finite samples counts as not recorded."""


@dataclass
class FoundJoint:
    """Columns found so far, with source and remarks of each."""

    columns: dict[str, FloatArray] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    grains: dict[str, Grain] = field(default_factory=dict)


@dataclass
class Collector:
    """Goes through the topics one by one; only aligned columns stay in memory."""

    bag: BagReader
    source_map: SourceMap
    wanted: Sequence[str] | None
    start_s: float
    seconds: float | None
    base: TimeBase | None = None
    factor: int = 1
    found: dict[str, FoundJoint] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    _times: FloatArray | None = None

    def collect(self) -> None:
        """Reads the best source of every signal, then the next best for joints that are still without it."""
        listed = {name: self.source_map.signals[name] for name in SIGNALS if name in self.source_map.signals}
        ranked = {name: [s for s in sources if self._usable(s)] for name, sources in listed.items()}
        for rank in range(max((len(sources) for sources in ranked.values()), default=0)):
            by_topic: dict[str, list[SignalSource]] = {}
            for name, sources in ranked.items():
                if rank < len(sources) and (rank == 0 or self._missing(name)):
                    by_topic.setdefault(self.bag.resolve(sources[rank].topic), []).append(sources[rank])
            for topic in sorted(by_topic, key=self._weight, reverse=True):
                self._read(topic, by_topic[topic])

    def joint_names(self) -> list[str]:
        """Joints with at least one signal, in the order of the mapping or the bag."""
        names = [name for name, joint in self.found.items() if joint.columns]
        order = list(self.source_map.joints)
        return sorted(names, key=order.index) if order else names

    def joint(self, name: str) -> JointSignals:
        """The signals of one joint."""
        assert self.base is not None
        joint = self.found[name]
        period, count = self.base.period * self.factor, self.base.count // self.factor
        valid: BoolArray = np.ones(count, dtype=bool)
        for signal in MEASURED:
            if signal in joint.columns:
                valid &= np.isfinite(joint.columns[signal])
        return JointSignals(
            joint=name,
            time=self._time(period, count),
            period=period,
            valid=valid,
            sources=dict(joint.sources),
            notes=(*joint.notes, *_remarks(joint, valid, period)),
            grains=dict(joint.grains),
            **joint.columns,  # type: ignore[arg-type] # the names are those of SIGNALS
        )

    def _time(self, period: float, count: int) -> FloatArray:
        """The time of the rows, s; one array for all joints, which nobody may change."""
        if self._times is None:
            self._times = period * np.arange(count, dtype=np.float64)
            self._times.setflags(write=False)
        return self._times

    def _usable(self, source: SignalSource) -> bool:
        if not self.bag.has(source.topic):
            return False
        topic = self.bag.resolve(source.topic)
        if has_fixed_layout(self.bag.topics[topic]):
            return True
        self.notes.append(f"{topic}: {self.bag.topics[topic]} has no columns and is not read")
        return False

    def _held(self, source: SignalSource) -> bool:
        """Does a value stay until the next stamp? A bag made of a table says which signals were measured at theirs."""
        return source.held and source.signal not in self.bag.metadata.get(SESSION, {}).get(AT_STAMPS, "").split()

    def _missing(self, signal: str) -> bool:
        return any(signal not in joint.columns for joint in self.found.values())

    def _weight(self, topic: str) -> tuple[bool, int]:
        """Topics of joint states with most messages first: they make the time base."""
        return "Temperature" not in self.bag.topics[topic], self.bag.counts[topic]

    def _read(self, topic: str, sources: Sequence[SignalSource]) -> None:
        columns = open_topic(self.bag, topic)
        names = [name for name in columns.names if self._is_wanted(name)]
        if not names or columns.stamps_ns.size == 0:
            return
        for rows, group in _streams(columns, names, sources):
            stamps, keep = self._clean(topic, columns, rows)
            if self.base is None:
                self._set_base(topic, stamps)
            for source in sources:
                self._take(topic, source, columns, group, stamps, keep)

    def _is_wanted(self, source_joint: str) -> bool:
        ours = self.source_map.ours(source_joint)
        return ours is not None and (self.wanted is None or ours in self.wanted)

    def _clean(self, topic: str, columns: TopicColumns, rows: Rows) -> tuple[IntArray, Rows]:
        """Rising stamps of some rows and the rows they belong to; what was dropped becomes a problem."""
        stamps = columns.stamps_ns[rows]
        if stamps.size > 1 and bool((stamps == stamps[0]).all()):
            self.notes.append(f"{topic}: header stamps are all equal; the times of recording are used")
            stamps = columns.log_times_ns()[rows]
        clock = one_clock(stamps)
        other = stamps.size - (clock.stop - clock.start)
        if other:
            text = f"{topic}: {other} of {stamps.size} samples are of another clock (two recordings in one file?)"
            self.problems.append(f"{text}; the longest part is read, {(clock.stop - clock.start)} samples")
        keep = clock.start + rising(stamps[clock])
        if keep.size < stamps.size - other:
            dropped = stamps.size - other - keep.size
            self.problems.append(f"{topic}: {dropped} of {stamps.size} samples dropped, their stamps repeat or go back")
        kept = stamps if keep.size == stamps.size else stamps[keep]
        stretch = longest_stretch(kept)
        if stretch.stop - stretch.start < keep.size:
            dropped = keep.size - (stretch.stop - stretch.start)
            self.problems.append(f"{topic}: {dropped} of {stamps.size} samples dropped, the clock jumped")
            keep, kept = keep[stretch], kept[stretch]
        if keep.size == stamps.size:
            return kept, rows
        return kept, keep if isinstance(rows, slice) else rows[keep]

    def _set_base(self, topic: str, stamps: IntArray) -> None:
        whole = time_base(stamps, f"{self.bag.path}: {topic}")
        self.base = whole.window(self.start_s, self.seconds)
        self.factor = factor_of(self.base.count)
        if self.factor > 1:
            rate = 1.0 / (self.base.period * self.factor)
            self.notes.append(
                f"longer than {LONGEST_ROWS} samples: decimated by {self.factor} to {rate:.4g} Hz; read a part for more"
            )
        if not whole.even:
            self.notes.append(
                f"time stamps scatter by {1e3 * whole.jitter:.3g} ms around {1e3 * whole.period:.4g} ms; "
                "all signals were interpolated onto even ticks"
            )

    def _take(
        self,
        topic: str,
        source: SignalSource,
        columns: TopicColumns,
        names: Sequence[str],
        stamps: IntArray,
        keep: Rows,
    ) -> None:
        """Aligned columns of one signal for the joints that are without it."""
        assert self.base is not None
        late = round((source.delay - source.acts_later * self.base.period) * NS)
        if not columns.has(source.field) or stamps.size < 1:
            return
        alignment = Alignment(self.base, stamps, late) if stamps.size > 1 or source.signal in SLOW else None
        for name in names:
            ours = self.source_map.ours(name)
            assert ours is not None
            joint = self.found.setdefault(ours, FoundJoint())
            if source.signal in joint.columns or alignment is None:
                continue
            values = source.convert(ours, columns.column(source.field, name)[keep])
            self._keep(joint, source, topic, values, alignment)

    def _keep(
        self, joint: FoundJoint, source: SignalSource, topic: str, values: FloatArray, alignment: Alignment
    ) -> None:
        signal, slow = source.signal, source.signal in SLOW
        finite = np.isfinite(values).mean()
        if finite < EMPTY:
            joint.notes.append(f"{signal}: {topic} holds {'no number' if finite == 0.0 else 'hardly a number'}")
            return
        if alignment.spacing > SLOWEST and not slow:
            joint.notes.append(f"{signal}: {topic} is {alignment.spacing:.0f} times slower than the rest; left out")
            return
        if alignment.spacing > 1.5 and not slow:
            rate = 1.0 / (alignment.spacing * alignment.base.period)
            joint.notes.append(f"{signal}: recorded at {rate:.4g} Hz and interpolated; nothing faster is in it")
        column = alignment.slow_column(values) if slow else alignment.column(values, self._held(source))
        if not np.isfinite(column).any():
            joint.notes.append(f"{signal}: {topic} has no samples in the time of the others")
            return
        if source.acts_later:
            joint.notes.append(f"{signal}: from {topic}, moved {source.acts_later} sample later, when it acts")
        averaged = signal == "motor_torque" and not self._held(source)
        joint.grains[signal] = grain_of(values, averaged and self.factor == 1)
        if averaged:
            column = held_from_measured(column)
        joint.columns[signal] = column if self.factor == 1 else decimate(column, self.factor, signal == "motor_torque")
        joint.sources[signal] = topic


def _streams(
    columns: TopicColumns, names: Sequence[str], sources: Sequence[SignalSource]
) -> list[tuple[Rows, Sequence[str]]]:
    """Rows that belong to the same joints: joints that come in messages of their own have their own stamps."""
    field_name = next((s.field for s in sources if columns.has(s.field)), None)
    everything = slice(None)
    if field_name is None or len(columns.names) < 2:
        return [(everything, names)]
    present = columns.present(field_name, columns.names)
    if bool(present.all()):
        return [(everything, names)]
    alone = present.sum(axis=1) <= 1
    if float(alone.mean()) < 0.9:
        return [(everything, names)]
    return [(np.flatnonzero(present[:, columns.names.index(name)]), [name]) for name in names]


def _remarks(joint: FoundJoint, valid: BoolArray, period: float) -> list[str]:
    """Constant signals and gaps in words."""
    found = []
    for signal, column in joint.columns.items():
        finite = column[np.isfinite(column)]
        if float(np.ptp(finite)) == 0.0 and signal not in OPTIONAL:
            found.append(f"{signal}: constant at {finite[0]:.6g}")
    missing = ~valid
    if missing.any():
        starts = int(np.count_nonzero(missing[1:] & ~missing[:-1])) + int(missing[0])
        seconds = float(missing.sum()) * period
        found.append(f"{starts} gaps, {seconds:.3f} s of {valid.size * period:.3f} s without all measured signals")
    return found


# ---- The recording ---------------------------------------------------------------------------------


DESCRIPTION, ATTACHED_DESCRIPTION = "robot_description", "robot.urdf"


def read_recording(
    path: str | Path,
    mapping: SourceMap | str | Path | None = None,
    joints: Sequence[str] | None = None,
    start_s: float = 0.0,
    seconds: float | None = None,
) -> Recording:
    """The joints of a bag (all, or those named) within [start_s, start_s + seconds). `mapping`: file or shipped name.

    A recording of more than 20 min at 1 kHz is decimated, with a note. Raises BagError if the bag cannot be read, has
    no position together with a torque, or not a joint that was asked for.
    """
    source_map = STANDARD if mapping is None else mapping if isinstance(mapping, SourceMap) else load_mapping(mapping)
    with BagReader(path) as bag:
        collector = Collector(bag, source_map, joints, start_s, seconds)
        collector.collect()
        found = {name: collector.joint(name) for name in collector.joint_names()}
        _check(bag, found, joints, source_map)
        problems = [str(problem) for problem in bag.problems if problem.loses_data]
        base = collector.base
        return Recording(
            path=str(path),
            sha256=bag_sha256(path),
            joints=found,
            robot=robot_text(bag),
            notes=tuple(dict.fromkeys(collector.notes)),
            problems=tuple(dict.fromkeys([*problems, *collector.problems])),
            start_ns=0 if base is None else base.start_ns,
        )


def bag_sha256(path: str | Path) -> str:
    """SHA-256 of the storage files of a bag, in the order of their names; of the file itself if it is one."""
    path = Path(path)
    files = [path] if path.is_file() else sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def robot_text(bag: BagReader) -> str | None:
    """The robot description that the bag carries: the last message, else the attachment; None if there is none."""
    if bag.has(DESCRIPTION):
        texts = [str(message.data) for _, message in bag.messages(DESCRIPTION) if hasattr(message, "data")]
        if texts:
            return texts[-1]
    attached = bag.attachments.get(ATTACHED_DESCRIPTION)
    return None if attached is None else attached.decode("utf-8", "replace")


def _check(bag: BagReader, found: dict[str, JointSignals], joints: Sequence[str] | None, source_map: SourceMap) -> None:
    """Raises BagError if no balance can be made of what was found."""
    there = ", ".join(sorted(bag.topics)) or "no topic"
    hint = "; a foreign bag needs --map" if source_map is STANDARD else f"; the mapping is {source_map.name}"
    if joints is not None:
        unknown = [name for name in joints if name not in found]
        if unknown and found:
            raise BagError(f"{bag.path}: no signals of joint {unknown[0]}; there is {', '.join(found)}")
        if unknown:
            known = dict.fromkeys(name for s in source_map.signals.values() for name in _joints_of(bag, s, source_map))
            raise BagError(f"{bag.path}: no joint {unknown[0]}; there is {', '.join(known) or there}{hint}")
    if not found:
        raise BagError(f"{bag.path}: no signal of a joint; there is {there}{hint}")
    angle = any({"motor_shaft_position", "joint_position"} & set(joint.present) for joint in found.values())
    torque = any({"gauge_torque", "motor_torque"} & set(joint.present) for joint in found.values())
    if not angle or not torque:
        what = (
            "neither a position nor a torque" if not angle and not torque else "no torque" if angle else "no position"
        )
        raise BagError(f"{bag.path}: {what} of a joint is recorded; there is {there}{hint}")


def _joints_of(bag: BagReader, sources: Sequence[SignalSource], source_map: SourceMap) -> list[str]:
    names = [name for source in sources if bag.has(source.topic) for name in bag.columns(source.topic).names]
    return [ours for name in names if (ours := source_map.ours(name)) is not None]
