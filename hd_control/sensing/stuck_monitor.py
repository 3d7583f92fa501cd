"""F03 for the two position sensors: one repeats a reading while the others show that it ought to have moved.

A position sensor at rest repeats itself, so repetition alone says nothing. Motor position phi, joint position q and
gauge torque tau are tied by the spring, phi - q = tau / k: each position is expected from the other one and the torque,
also when a blocked joint winds the spring up. Kinematic error and hysteresis stay in the expectation; the limit allows
for them. And the other position must have moved itself: a gauge that drifts at standstill is no motion.

A gauge that repeats itself is found by `sensor_monitors.frozen`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control import _monitors
from hd_control.core.arrays import FloatArray
from hd_control.core.faults import Action, Fault, FaultCode

ENCODER, RESOLVER = range(2)


@dataclass(frozen=True)
class Stuck:
    """Memory, arrays (2, n) of encoder and resolver: reading, its repetitions; when it changed last: what was expected,
    and the other reading.
    """

    reading: FloatArray
    repeats: FloatArray
    expected: FloatArray
    other: FloatArray


def first_stuck(positions: FloatArray) -> Stuck:
    """The memory after the first positions (2, n)."""
    return Stuck(positions.copy(), np.zeros_like(positions), np.full_like(positions, np.nan), positions[::-1].copy())


def stuck(
    positions: FloatArray, twist: FloatArray, memory: Stuck, samples: float, limit: FloatArray, step: float = 1.0
) -> tuple[FloatArray, Stuck, list[Fault]]:
    """Motion that was missed (n,) rad, the larger of both sensors, the new memory, faults.

    `positions` (2, n) rad at the output side: motor, joint. `twist` (n,) rad: gauge torque over stiffness, less the
    known kinematic error. `samples` equal readings and more than `limit` (n,) rad of expected motion stop the robot;
    `step` samples lie between two calls. Numbers that are not finite expect nothing.
    """
    ordinary, repeats, expected, other, moved = _monitors.missed_motion(
        positions, twist, memory.reading, memory.repeats, memory.expected, memory.other, samples, limit, step
    )
    new, most = Stuck(positions.copy(), repeats, expected, other), moved.max(axis=0)
    if ordinary:
        return most, new, []
    faults = [
        Fault(FaultCode.VALUE_FROZEN, int(j), float(repeats[s, j]), samples, Action.CONTROLLED_STOP)
        for s, j in np.argwhere(moved > limit)
    ]
    return most, new, faults
