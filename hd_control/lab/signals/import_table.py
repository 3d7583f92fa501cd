"""A table of a foreign robot (CSV, NPZ) becomes a bag of this project, by a mapping."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.errors import BagError
from hd_control.core.topics import JOINT_STATE_TYPE, TEMPERATURE, signal_places
from hd_control.lab.signals.sources import AT_STAMPS, QUANTITIES, SignalSource, SourceMap, TimeSource
from hd_control.lab.signals.time_base import FEWEST, NS, rising
from hd_control.record.cdr import JointStateCodec, TemperatureCodec
from hd_control.record.tables import read_table
from hd_control.record.writer import BagWriter

FIELDS = ("position", "velocity", "effort")
JOINT = "{joint}"
TABLE = SourceMap(
    "columns as hd export names them",
    {name: (SignalSource(name, columns=name, held=name == "motor_torque"),) for name in QUANTITIES},
    time=TimeSource("time"),
)
"""The table that `hd export` writes: `time` in s; `joint.signal` in CSV, arrays named like the signals in NPZ."""


@dataclass(frozen=True)
class Imported:
    """What was written: joints, signals, samples, seconds, and what was dropped (`problems`) or is odd (`notes`)."""

    joints: tuple[str, ...]
    signals: tuple[str, ...]
    samples: int
    seconds: float
    problems: tuple[str, ...]
    notes: tuple[str, ...]


def import_table(table: str | Path, bag: Path, mapping: SourceMap | None = None, robot: str | None = None) -> Imported:
    """Writes a new bag with the topics of this project in SI. `robot`: URDF text to carry. Raises BagError."""
    columns, names = read_table(table)
    source_map = TABLE if mapping is None else mapping
    where = str(table)
    found = _signals(columns, source_map, names, where)
    lengths = {len(values) for by_joint in found.values() for values in by_joint.values()}
    if len(lengths) > 1:
        raise BagError(f"{where}: the columns have different lengths: {', '.join(map(str, sorted(lengths)))}")
    stamps, keep, problems = _stamps(columns, source_map.time, lengths.pop(), where)
    stamps += max(0, *(round(source_map.signals[name][0].delay * NS) for name in found))
    joints = tuple(dict.fromkeys(joint for signal in found.values() for joint in signal))
    metadata = {"imported_from": Path(table).name, "mapping": Path(source_map.name).name}
    if "motor_torque" in found and not source_map.signals["motor_torque"][0].held:
        metadata[AT_STAMPS] = "motor_torque"
    with BagWriter(bag, live=False, metadata=metadata) as writer:
        if robot is not None:
            writer.attach("robot.urdf", robot, "application/xml")
        for name, by_joint in found.items():
            source = source_map.signals[name][0]
            kept = {joint: source.convert(joint, values[keep]) for joint, values in by_joint.items()}
            _write(writer, name, kept, stamps - round(source.delay * NS))
        writer.close()
    notes = tuple(
        f"{name} of {joint} holds no number"
        for name, by_joint in found.items()
        for joint, values in by_joint.items()
        if not np.isfinite(values).any()
    )
    return Imported(joints, tuple(found), stamps.size, float(stamps[-1] - stamps[0]) / NS, problems, notes)


def _signals(
    columns: Mapping[str, FloatArray], source_map: SourceMap, names: tuple[str, ...], where: str
) -> dict[str, dict[str, FloatArray]]:
    """Raw columns: signal -> joint -> (n,)."""
    found: dict[str, dict[str, FloatArray]] = {}
    for signal, sources in source_map.signals.items():
        by_joint = _columns_of(columns, sources[0], source_map, names, where)
        if by_joint:
            found[signal] = by_joint
    if not found:
        some = ", ".join(list(columns)[:20])
        hint = "a foreign table needs --map" if source_map is TABLE else f"the mapping is {source_map.name}"
        raise BagError(f"{where}: no column of a signal; there is {some}; {hint}")
    return found


def _columns_of(
    columns: Mapping[str, FloatArray], source: SignalSource, source_map: SourceMap, names: tuple[str, ...], where: str
) -> dict[str, FloatArray]:
    own = source_map is TABLE
    pattern = source.columns
    if not isinstance(pattern, str):
        return {joint: _column(columns, name, where) for joint, name in pattern.items()}
    if not pattern:
        return {}
    if JOINT in pattern or (own and pattern not in columns):
        return _by_pattern(columns, f"{JOINT}.{pattern}" if own else pattern, source_map, where)
    if own and pattern not in columns:
        return {}
    values = columns.get(pattern)
    if values is None:
        raise BagError(f"{where}: no column {pattern!r}; there is {', '.join(list(columns)[:20])}")
    table = values.reshape(len(values), -1)
    joints = list(source_map.joints) or list(names) or [f"joint_{k + 1}" for k in range(table.shape[1])]
    if len(joints) != table.shape[1]:
        raise BagError(f"{where}: {pattern!r} has {table.shape[1]} columns, the mapping names {len(joints)} joints")
    return {joint: np.ascontiguousarray(table[:, k]) for k, joint in enumerate(joints)}


def _by_pattern(
    columns: Mapping[str, FloatArray], pattern: str, source_map: SourceMap, where: str
) -> dict[str, FloatArray]:
    """Columns named after their joints; without a list of joints every name that fits the pattern is one."""
    if source_map.joints:
        pairs = source_map.joints.items()
        return {ours: _column(columns, pattern.replace(JOINT, theirs), where) for ours, theirs in pairs}
    head, _, tail = pattern.partition(JOINT)
    search = re.compile(f"{re.escape(head)}(.+?){re.escape(tail)}$")
    matches = {name: search.match(name) for name in columns}
    return {match[1]: columns[name] for name, match in matches.items() if match is not None}


def _column(columns: Mapping[str, FloatArray], name: str, where: str) -> FloatArray:
    if name not in columns:
        raise BagError(f"{where}: no column {name!r}; there is {', '.join(list(columns)[:20])}")
    values = columns[name]
    if values.ndim != 1:
        raise BagError(f"{where}: {name!r} has {values.shape[1]} columns; name one column per joint")
    return values


def _stamps(
    columns: Mapping[str, FloatArray], time: TimeSource, count: int, where: str
) -> tuple[IntArray, IntArray, tuple[str, ...]]:
    """Rising stamps in ns from 0 on, the rows they belong to, and what was dropped."""
    if not time.column and time.period == 0.0:
        raise BagError(f"{where}: the mapping says nothing of the time; name its column or the period")
    seconds = _column(columns, time.column, where) * time.unit if time.column else np.arange(count) * time.period
    if len(seconds) != count:
        raise BagError(f"{where}: {len(seconds)} times for {count} samples")
    rows = np.flatnonzero(np.isfinite(seconds))
    if rows.size < FEWEST:
        raise BagError(f"{where}: {rows.size} samples with a time, at least {FEWEST} are needed")
    seconds = seconds[rows] - float(seconds[rows].min())
    if time.period > 0.0:
        seconds = np.round(seconds / time.period) * time.period
    stamps = np.round(seconds * NS).astype(np.int64)
    keep = rising(stamps)
    dropped = count - keep.size
    text = f"{dropped} of {count} rows dropped, their times repeat, go back or are missing"
    return stamps[keep], rows[keep], (text,) if dropped else ()


def _write(writer: BagWriter, signal: str, columns: Mapping[str, FloatArray], stamps: IntArray) -> None:
    """One signal of all its joints as messages."""
    if signal == "temperature":
        for joint, values in columns.items():
            codec = TemperatureCodec(joint)
            writer.write_columns(TEMPERATURE, codec, stamps, frame_id=joint, temperature=values[:, None])
        return
    topic, field = signal_places()[signal][0]
    codec_of_joints = JointStateCodec(list(columns), 0, **{name: name == field for name in FIELDS})
    writer.add_topic(topic, JOINT_STATE_TYPE, period_ns=round(float(np.median(np.diff(stamps)))))
    table = np.column_stack(list(columns.values()))
    writer.write_columns(topic, codec_of_joints, stamps, frame_id="", **{field: table})
