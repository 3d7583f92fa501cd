"""Black box: the last seconds of every signal of a process, and every fault, in memory; a stop keeps them.

The loop only copies numbers into a ring; `FaultBook` merges faults by code and joint. A stop keeps the ring with one
second after it. Whoever lives outside the loop takes finished incidents and may write them
(`hd_control.record.black_box_files`); what nobody takes stays here, at most `KEPT`, the oldest is given up first.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.record.black_box_files import KEPT, Incident

BEFORE, AFTER = 2.0, 1.0
"""s that an incident keeps before and after the stop."""
Cause = Fault | BaseException
UNKNOWN_STOP = Fault(FaultCode.STOP_LEFT, -1, float("nan"), float("nan"), Action.TORQUE_RAMP)
"""Of a latched stop whose fault nobody has kept."""
Columns = Mapping[tuple[str, str], slice]
"""Where the array of a topic lies in an array of numbers, by topic and name."""


@dataclass
class _Stop:
    """A stop whose incident is not complete yet: number of its row, what caused it."""

    row: int
    cause: Cause


class BlackBox:
    """A ring of rows for a loop with a tick of `period` s. `note` belongs to the loop, the rest to any thread."""

    def __init__(self, period: float) -> None:
        self._before, self._after = round(BEFORE / period), round(AFTER / period)
        self._span = self._before + 1 + self._after
        self._arrays: list[FloatArray] = []
        self._columns: list[tuple[str, str, tuple[str, ...], slice]] = []
        self._rows: FloatArray | None = None
        self.written = 0
        self._stopped = False
        self._open: list[_Stop] = []
        self._kept: list[Incident] = []
        self._names: tuple[str, ...] = ()
        self._lock = threading.Lock()

    def watch(self, joint_names: Sequence[str], numbers: FloatArray, columns: Columns) -> None:
        """Adds an array that is looked at in every tick; before the first one. A topic known already is left out."""
        known = {(topic, name) for topic, name, _, _ in self._columns}
        start = 1 + sum(array.size for array in self._arrays)
        new = {key: part for key, part in columns.items() if key not in known}
        self._arrays += [numbers] if new else []
        self._names = self._names or tuple(joint_names)
        for (topic, name), part in new.items():
            self._columns.append((topic, name, tuple(joint_names), slice(start + part.start, start + part.stop)))

    def note(self, tick: int, cause: Cause | None) -> None:
        """One row. `cause` is what the robot is stopped by, None while it is not; the first of a stop counts."""
        rows = self._rows
        if rows is None:
            rows = self._rows = np.empty((2 * self._span, 1 + sum(array.size for array in self._arrays)))
        if self._open and self.written - max(0, self._open[0].row - self._before) >= len(rows):
            self._keep(1)  # nobody has taken it: before its rows are used again
        row = rows[self.written % len(rows)]
        row[0] = tick
        np.concatenate(self._arrays, out=row[1:])
        self.written += 1
        if cause is not None and not self._stopped:
            self.mark(cause)
        self._stopped = cause is not None

    def mark(self, cause: Cause) -> None:
        """A stop at the newest row, also if no further row may follow. The same cause again is the same stop."""
        with self._lock:
            if not (self._open and self._open[-1].cause is cause):
                self._open.append(_Stop(max(0, self.written - 1), cause))

    @property
    def incidents(self) -> int:
        """How many stops have not been taken."""
        return len(self._open) + len(self._kept)

    @property
    def waits(self) -> bool:
        """True while a stop still waits for the rows after it."""
        return bool(self._open)

    def take(self, all_of_them: bool = False) -> list[Incident]:
        """Finished incidents, oldest first; they are gone here then. `all_of_them`: also those that wait for rows."""
        ready = sum(all_of_them or self.written > stop.row + self._after for stop in self._open)
        self._keep(ready)
        with self._lock:
            found, self._kept = self._kept, []
        return found

    def _keep(self, count: int) -> None:
        """Copies the rows of the first open stops out of the ring."""
        with self._lock:
            for stop in self._open[:count]:
                self._kept.append(self._incident(stop))
            del self._open[:count]
            del self._kept[:-KEPT]

    def _incident(self, stop: _Stop) -> Incident:
        rows = self._rows
        if rows is None:
            return Incident(np.zeros(0, dtype=np.int64), {}, -1, *words(stop.cause, self._names))
        numbers = np.arange(max(0, stop.row - self._before), min(self.written, stop.row + self._after + 1))
        table = rows[numbers % len(rows)]
        topics: dict[str, tuple[tuple[str, ...], dict[str, FloatArray]]] = {}
        for topic, name, joints, part in self._columns:
            topics.setdefault(topic, (joints, {}))[1][name] = table[:, part]
        ticks = table[:, 0].astype(np.int64)
        return Incident(ticks, topics, int(rows[stop.row % len(rows), 0]), *words(stop.cause, self._names))


def words(cause: Cause, joint_names: Sequence[str]) -> tuple[str, str]:
    """Code and full text of a cause, the traceback of an exception included."""
    if isinstance(cause, Fault):
        return cause.code.number, cause.text(joint_names)
    import traceback

    lines: Any = "".join(traceback.format_exception(cause)).strip()
    return FaultCode.EXCEPTION.number, FaultCode.EXCEPTION.line(f"{cause!r}\n{lines}")


# ---- Faults of a loop: the first of each code and joint with its numbers, and how often; text is made outside ----


class FaultBook:
    """Written by the loop, read by diagnostics."""

    def __init__(self) -> None:
        self._entries: dict[tuple[FaultCode, int], list[Any]] = {}
        self.first_stop: Fault | None = None
        self.first_stop_tick = -1

    def note(self, faults: Iterable[Fault], tick: int) -> None:
        """Counts faults of one tick; the first that stops keeps its numbers until `clear`."""
        for fault in faults:
            entry = self._entries.setdefault((fault.code, fault.joint), [0, tick, fault])
            entry[0] += 1
            if self.first_stop is None and fault.action >= Action.CONTROLLED_STOP:
                self.first_stop, self.first_stop_tick = fault, tick

    def clear(self) -> None:
        """After a granted reset."""
        self._entries.clear()
        self.first_stop, self.first_stop_tick = None, -1

    def values(self, joint_names: Sequence[str]) -> dict[str, str]:
        """One value for each code and joint: count, first tick, text of the first."""
        found = {}
        for (code, joint), (count, tick, fault) in list(self._entries.items()):
            where = joint_names[joint] if joint >= 0 else "robot"
            found[f"{code.text} {where}"] = f"{count} times since tick {tick}: {fault.text(joint_names)}"
        return found

    def headline(self, joint_names: Sequence[str]) -> str:
        """The fault that stopped the robot, in one line; empty if none did."""
        return self.first_stop.text(joint_names) if self.first_stop is not None else ""
