"""Blocks of time that are dealt to folds: what is held out is never next to what is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Blocks:
    """Blocks of `length` s with a guard, dealt to `folds` folds in turn."""

    length: float = 0.66
    guard: float = 0.05
    folds: int = 6

    def of(self, time: FloatArray) -> tuple[IntArray, IntArray]:
        """(block, fold) of each row; fold -1 in the guards."""
        block = np.floor(time / self.length).astype(np.int64)
        inside = time - block * self.length
        guard = (inside < 0.5 * self.guard) | (inside > self.length - 0.5 * self.guard)
        return block, np.where(guard, -1, block % self.folds)
