"""Counters and angles: resolution, quantisation, unwrapping. Readable forms; the fusion law has them compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray


def motor_count(counts_per_turn: float, gear_ratio: float) -> float:
    """One motor-encoder count as an angle at the joint, rad: 2 pi / (counts N)."""
    return 2.0 * math.pi / (counts_per_turn * gear_ratio)


def joint_count(bits: int) -> float:
    """One count of a joint sensor, rad: 2 pi / 2^bits."""
    return 2.0 * math.pi / 2.0**bits


def quantise(angle: Any, count: float) -> Any:
    """The reading of a sensor with resolution `count`: count floor(angle / count + 1/2). Floats or arrays, rad."""
    return count * np.floor(np.asarray(angle) / count + 0.5)


def unwrap_step(reading: float, period: float, last: float, turns: float) -> tuple[float, float]:
    """(continuous angle, new turns) of one reading, rad. The modular difference to `last` is below half a period.

    The number of periods is kept, not a running sum, so no rounding piles up. A period of 0 leaves the reading alone.
    """
    if period > 0.0:
        turns -= math.floor((reading - last) / period + 0.5)
    return reading + turns * period, turns


def unwrap(readings: FloatArray, period: float) -> FloatArray:
    """A whole record (ticks,) made continuous; correct for steps below half a period. Starts at the first reading."""
    readings = np.asarray(readings, dtype=float)
    jumps = np.floor(np.diff(readings, prepend=readings[:1]) / period + 0.5)
    return np.asarray(readings - np.cumsum(jumps) * period)
