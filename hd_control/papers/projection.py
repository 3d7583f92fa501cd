"""Projection function P: the bounded integrator that updates every adapted parameter. Zhu (11), (12), (38), (40)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def project(value: ArrayLike, drive: ArrayLike, gain: ArrayLike, low: ArrayLike, high: ArrayLike, dt: float) -> Any:
    """One step of P, exact for a drive that is constant over `dt` s. Floats or arrays of one shape; returns the same.

    `value` is P before the step, `drive` s, `gain` rho. The result P+ lies in [low, high], and for every theta in there
    (theta - P+)(drive - (P+ - value) / (gain dt)) <= 0 when `value` was inside too. A drive that is not a number counts
    as zero.
    """
    value, drive = np.asarray(value, dtype=float), np.asarray(drive, dtype=float)
    drive = np.where(np.isnan(drive), 0.0, drive)
    held = ((value <= low) & (drive <= 0.0)) | ((value >= high) & (drive >= 0.0))
    moved = np.where(held, value, value + dt * np.asarray(gain) * drive)
    bounded = np.where(moved >= low, np.where(moved <= high, moved, high), low)
    return bounded if bounded.ndim else float(bounded)
