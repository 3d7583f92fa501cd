"""Goes through the topics of a bag one by one and keeps every joint's columns, aligned; whatever is odd is noted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hd_control.analysis.decimate import LONGEST_ROWS, decimate, factor_of
from hd_control.analysis.signals import SIGNALS, JointSignals
from hd_control.analysis.sources import SignalSource, SourceMap, held_from_measured
from hd_control.analysis.time_base import NS, SLOWEST, Alignment, TimeBase, longest_stretch, rising, time_base
from hd_control.analysis.topic_columns import TopicColumns, open_topic
from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.record.columns import has_fixed_layout
from hd_control.record.reader import BagReader

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
        """Reads the best source of every signal, then the next best for joints that still lack it."""
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
        keep = rising(stamps)
        if keep.size < stamps.size:
            dropped = stamps.size - keep.size
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
        """Aligned columns of one signal for the joints that lack it."""
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
        column = alignment.slow_column(values) if slow else alignment.column(values, source.held)
        if not np.isfinite(column).any():
            joint.notes.append(f"{signal}: {topic} has no samples in the time of the others")
            return
        if source.acts_later:
            joint.notes.append(f"{signal}: from {topic}, moved {source.acts_later} sample later, when it acts")
        if not source.held and signal == "motor_torque":
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
