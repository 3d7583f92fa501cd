"""Faults of a loop, merged: the first of each code and joint with its numbers, and how often. Text is made outside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from hd_control.core.faults import Action, Fault, FaultCode


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
