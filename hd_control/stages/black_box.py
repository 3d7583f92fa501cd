"""Black box: the last seconds of a stage's numbers in memory, kept from before a stop until they are cleared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hd_control.core.blocks import FloatArray


class BlackBox:
    """A ring of rows; after a stop it takes `after` more rows and then stands still. Nothing is written to a disk."""

    def __init__(self, before: int, after: int) -> None:
        self._rows: FloatArray | None = None
        self._size, self._after = before + 1 + after, after
        self._next = self._count = 0
        self._left = -1

    def note(self, tick: int, parts: Sequence[FloatArray], stopped: bool) -> None:
        """One row: tick and numbers. `stopped` for the first time starts the last `after` rows."""
        if self._left == 0:
            return
        if self._rows is None:
            self._rows = np.empty((self._size, 1 + sum(part.size for part in parts)))
        row = self._rows[self._next]
        row[0] = tick
        np.concatenate(parts, out=row[1:])
        self._next = (self._next + 1) % self._size
        self._count = min(self._count + 1, self._size)
        if self._left > 0:
            self._left -= 1
        elif stopped:
            self._left = self._after

    @property
    def complete(self) -> bool:
        """True once it stands still after a stop."""
        return self._left == 0

    def rows(self) -> FloatArray:
        """What is there, oldest first: tick, then the numbers (rows, 1 + n)."""
        if self._rows is None:
            return np.empty((0, 0))
        order = (np.arange(self._count) + self._next - self._count) % self._size
        return self._rows[order]

    def clear(self) -> None:
        """Begins anew, after a granted reset."""
        self._next = self._count = 0
        self._left = -1
