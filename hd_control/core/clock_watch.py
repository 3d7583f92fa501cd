"""F15: jumps of the system clock, seen against the steady clock. Time is an argument; the caller reads the clocks.

Control uses neither clock, so a jump has no effect on it; it is reported because the stamps of other programs may lie.
"""

from __future__ import annotations

from hd_control.core.faults import Action, Fault, FaultCode

TOLERANCE_NS = 100_000_000
"""A larger change of the difference of both clocks between two looks is a jump; slower ones are corrections."""


class ClockWatch:
    """Remembers the difference of the two clocks and the jumps of it."""

    def __init__(self) -> None:
        self.jumps = 0
        self.last: Fault | None = None
        self._difference: int | None = None

    def look(self, system_ns: int, steady_ns: int) -> Fault | None:
        """The jump since the last look, in s, or None."""
        before, self._difference = self._difference, system_ns - steady_ns
        if before is None or abs(self._difference - before) <= TOLERANCE_NS:
            return None
        jump = (self._difference - before) * 1e-9
        self.jumps += 1
        self.last = Fault(FaultCode.CLOCK_JUMP, -1, jump, TOLERANCE_NS * 1e-9, Action.REPORT)
        return self.last
