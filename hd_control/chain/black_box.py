"""Black box and fault book of a loop: what happened before and after a stop, and what was found, merged.

The loop only copies numbers (`RowRing`, `FaultTable` in `cpp/fault_rows.hpp`). Whoever lives outside the loop takes
finished incidents and may write them (`hd_control.record.black_box_files`); what nobody takes stays here, at most
`KEPT`, the oldest is given up first. Texts are made here, never in the loop.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control import _chain
from hd_control.core.arrays import FloatArray
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.record.black_box_files import KEPT, Incident
from hd_control.safety.gate import faults_of, rows_of

BEFORE, AFTER = 2.0, 1.0
"""s that an incident keeps before and after the stop."""
Cause = Fault | BaseException
Columns = Mapping[tuple[str, str], slice]
"""Where the array of a topic lies in an array of numbers, by topic and name."""
_EXCEPTION = Fault(FaultCode.EXCEPTION, -1, 1.0, 0.0, Action.TORQUE_RAMP)


def span(period: float) -> tuple[int, int]:
    """Rows before and after a stop that an incident keeps, for a loop with a tick of `period` s."""
    return round(BEFORE / period), round(AFTER / period)


@dataclass
class _Stop:
    """A stop whose incident is not complete yet: number of its row, what caused it."""

    row: int
    cause: Cause


class BlackBox:
    """A ring of rows for a loop with a tick of `period` s. The loop writes, everything else belongs to any thread.

    `ring`: the ring of a compiled loop; without one the box has its own, and `note` writes it.
    """

    def __init__(self, period: float, ring: Any = None) -> None:
        self._before, self._after = span(period)
        self._ring = _chain.RowRing(2 * (self._before + 1 + self._after)) if ring is None else ring
        self._columns: list[tuple[str, str, tuple[str, ...], slice]] = []
        self._seen = 0
        self._open: list[_Stop] = []
        self._kept: list[Incident] = []
        self._names: tuple[str, ...] = ()
        self._exception: BaseException | None = None
        self._lock = threading.Lock()

    def watch(self, joint_names: Sequence[str], numbers: FloatArray, columns: Columns) -> None:
        """Adds an array that is looked at in every tick; before the first one. A topic known already is left out."""
        known = {(topic, name) for topic, name, _, _ in self._columns}
        new = {key: part for key, part in columns.items() if key not in known}
        if new:
            self.adopt(joint_names, new, int(self._ring.width))
            self._ring.watch(numbers)

    def adopt(self, joint_names: Sequence[str], columns: Columns, start: int) -> None:
        """Names numbers that the loop watches already, from place `start` of a row on."""
        self._names = self._names or tuple(joint_names)
        for (topic, name), part in columns.items():
            self._columns.append((topic, name, tuple(joint_names), slice(start + part.start, start + part.stop)))

    @property
    def written(self) -> int:
        """Rows so far."""
        return int(self._ring.written)

    def note(self, tick: int, cause: Cause | None) -> None:
        """One row. `cause` is what the robot is stopped by, None while it is not; the first of a stop counts."""
        if isinstance(cause, BaseException):
            self._exception, cause = cause, _EXCEPTION
        self._ring.note(float(tick), None if cause is None else rows_of([cause])[0])
        self.look()

    def look(self) -> None:
        """Notices stops that the loop has marked, and keeps incidents before their rows are used again."""
        with self._lock:
            stops = int(self._ring.stops)
            for number in range(max(self._seen, stops - _chain.STOPS), stops):
                slot = number % _chain.STOPS
                [fault] = faults_of(self._ring.causes.reshape(-1, 5)[slot])
                cause: Cause = fault
                if fault.code is FaultCode.EXCEPTION and self._exception is not None:
                    cause = self._exception
                if not (self._open and self._open[-1].cause is cause):
                    self._open.append(_Stop(int(self._ring.stop_rows[slot]), cause))
            self._seen = stops
            # Rows are used again from here on; the next look may be a second away.
            limit = int(self._ring.rows) - self._after
            while self._open and self.written - max(0, self._open[0].row - self._before) >= limit:
                self._keep(1)

    def mark(self, cause: BaseException) -> None:
        """A stop at the newest row, also if no further row may follow. The same cause again is the same stop."""
        with self._lock:
            self._exception = cause
            if not (self._open and self._open[-1].cause is cause):
                self._open.append(_Stop(max(0, self.written - 1), cause))

    @property
    def incidents(self) -> int:
        """How many stops have not been taken."""
        self.look()
        return len(self._open) + len(self._kept)

    @property
    def waits(self) -> bool:
        """True while a stop still waits for the rows after it."""
        self.look()
        return bool(self._open)

    def take(self, all_of_them: bool = False) -> list[Incident]:
        """Finished incidents, oldest first; they are gone here then. `all_of_them`: also those that wait for rows."""
        self.look()
        with self._lock:
            self._keep(sum(all_of_them or self.written > stop.row + self._after for stop in self._open))
            found, self._kept = self._kept, []
        return found

    def _keep(self, count: int) -> None:
        """Copies the rows of the first open stops out of the ring."""
        for stop in self._open[:count]:
            self._kept.append(self._incident(stop))
        del self._open[:count]
        del self._kept[:-KEPT]

    def _incident(self, stop: _Stop) -> Incident:
        written, rows = self.written, int(self._ring.rows)
        if not written:
            return Incident(np.zeros(0, dtype=np.int64), {}, -1, *words(stop.cause, self._names))
        first = max(0, stop.row - self._before, written - rows)
        numbers = np.arange(first, min(written, stop.row + self._after + 1))
        table = self._ring.data.reshape(rows, -1)[numbers % rows]
        topics: dict[str, tuple[tuple[str, ...], dict[str, FloatArray]]] = {}
        for topic, name, joints, part in self._columns:
            topics.setdefault(topic, (joints, {}))[1][name] = table[:, part]
        ticks = table[:, 0].astype(np.int64)
        at = int(np.searchsorted(numbers, stop.row))
        tick = int(ticks[at]) if at < ticks.size else -1
        return Incident(ticks, topics, tick, *words(stop.cause, self._names))


def words(cause: Cause, joint_names: Sequence[str]) -> tuple[str, str]:
    """Code and full text of a cause, the traceback of an exception included."""
    if isinstance(cause, Fault):
        return f"HD-F{cause.code.value:02d}", cause.text(joint_names)
    import traceback

    lines: Any = "".join(traceback.format_exception(cause)).strip()
    return f"HD-F{FaultCode.EXCEPTION.value:02d}", f"{FaultCode.EXCEPTION.text}: {cause!r}\n{lines}"


class FaultBook:
    """Faults of a loop, merged: the first of each code and joint with its numbers, and how often.

    `table`: that of a compiled loop. Written by the loop, read by diagnostics.
    """

    def __init__(self, table: Any = None) -> None:
        self.table = _chain.FaultTable(32) if table is None else table

    def note(self, faults: Iterable[Fault], tick: int) -> None:
        """Counts faults of one tick; the first that stops keeps its numbers until `clear`."""
        self.table.note(rows_of(list(faults)), float(tick))

    def clear(self) -> None:
        """After a granted reset."""
        self.table.clear()

    @property
    def first_stop(self) -> Fault | None:
        """The fault that stopped the robot."""
        return faults_of(self.table.stop)[0] if self.table.stop_tick >= 0.0 else None

    @property
    def first_stop_tick(self) -> int:
        """Its tick, -1 if nothing is stopped."""
        return int(self.table.stop_tick)

    def values(self, joint_names: Sequence[str]) -> dict[str, str]:
        """One value for each code and joint: count, first tick, text of the first."""
        entries = self.table.entries.reshape(_chain.CODES, -1, 6).copy()
        order = sorted(np.argwhere(entries[:, :, 0] > 0.0).tolist(), key=lambda at: entries[at[0], at[1], 5])
        found = {}
        for code, place in order:
            count, tick, value, limit, action, _ = entries[code, place]
            fault = Fault(FaultCode(code), place - 1, float(value), float(limit), Action(int(action)))
            where = joint_names[place - 1] if place else "robot"
            text = f"{int(count)} times since tick {int(tick)}: {fault.text(joint_names)}"
            found[f"{fault.code.text} {where}"] = text
        return found

    def headline(self, joint_names: Sequence[str]) -> str:
        """The fault that stopped the robot, in one line; empty if none did."""
        stop = self.first_stop
        return stop.text(joint_names) if stop is not None else ""
