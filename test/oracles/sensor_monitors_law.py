"""Monitors of the three sensors of a joint: F01 to F10 of the fault table as functions on arrays.

Rows of a reading are encoder (output side, rad), resolver (rad) and gauge bridge (N m), columns are joints. No reading
is replaced in a recording: the raw topics keep what was received. Two bad readings in a row are bridged by the
prediction; from the third on the reading becomes "not a number", which no law uses and every gate stops on. A jump that
stays is taken over after it has stopped the robot, so that nothing is rejected for ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hd_control import _laws
from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Action, Fault, FaultCode

ENCODER, RESOLVER, GAUGE = range(3)
RAIL_SHARE = 0.99
WHOLE_TURN = 2.0 * math.pi
"""rad of the motor shaft over which the residual is integrated."""
LONGEST_WAY = 2.5 * math.pi
"""rad of the motor shaft within which a net turn must come about."""
LARGEST_STEP = 0.3
"""rad of the motor shaft between two looks: an integral over 4 beta needs ten looks per period."""
STOP_SHARE = 2.0
"""Residuals above their limit are reported, above this many times their limit they stop the robot."""
MOVED_COUNTS = 5.0
"""Twist limits; less motion than that does not show that a gauge ought to have changed."""


@dataclass(frozen=True)
class SensorLimits:
    """Limits of the monitors as plain arrays (n,) and numbers; names and units as in config/limits.yaml."""

    twist_limit: FloatArray
    gauge_rail: FloatArray
    residual_limit: FloatArray
    ripple_limit: FloatArray
    stuck_motion_limit: FloatArray
    disagree_samples: float
    frozen_samples: float
    rail_samples: float

    @cached_property
    def gauge_free(self) -> FloatArray:
        """Smaller gauge readings (n,) N m are not at the rail."""
        return RAIL_SHARE * self.gauge_rail

    @cached_property
    def gauge_motion(self) -> FloatArray:
        """Motor motion (n,) rad that a gauge cannot sleep through."""
        return MOVED_COUNTS * self.twist_limit

    @classmethod
    def from_block(cls, limits: Block) -> SensorLimits:
        """Of a GuardLimits block."""
        return cls(
            limits.twist_limit.copy(),
            limits.gauge_rail.copy(),
            limits.residual_limit.copy(),
            limits.ripple_limit.copy(),
            limits.stuck_motion_limit.copy(),
            float(limits.disagree_samples),
            float(limits.frozen_samples),
            float(limits.rail_samples),
        )


@dataclass(frozen=True)
class Screen:
    """Memory of `screen`, arrays (3, n): last accepted reading, slope per sample, last raw reading, bad in a row."""

    last: FloatArray
    slope: FloatArray
    raw: FloatArray
    bad: FloatArray


def first_screen(reading: FloatArray) -> Screen:
    """The memory after the first reading (3, n)."""
    zeros, usable = np.zeros_like(reading), _finite(reading)
    return Screen(usable, zeros, usable.copy(), zeros)


def _finite(reading: FloatArray) -> FloatArray:
    """A copy in which everything that is no finite number is NaN: arithmetic with it stays quiet."""
    return np.where(np.isfinite(reading), reading, np.nan)


def modular(difference: FloatArray, period: FloatArray | None) -> FloatArray:
    """The difference of two readings of counters that wrap at `period`; 0 or None: they do not."""
    if period is None:
        return difference
    wraps = period > 0.0
    turns = np.rint(np.divide(difference, period, out=np.zeros_like(difference), where=wraps))
    return difference - period * turns


def screen(
    reading: FloatArray, memory: Screen, limit: FloatArray, period: FloatArray | None, allowed_bad: float
) -> tuple[FloatArray, Screen, list[Fault]]:
    """F04 and F05. Readings (3, n) to use, the new memory, faults. `limit` (3, n): largest jump against the prediction.

    `period` (3, n): counters wrap at it; None: none does.
    """
    follow, slope = _laws.readings_follow(reading, memory.last, memory.slope, limit, period)
    if follow:
        copy = reading.copy()
        return reading, Screen(copy, slope, copy, np.zeros(slope.shape)), []
    predicted, raw = memory.last + memory.slope, _finite(reading)
    change = modular(reading - predicted, period)
    good = np.abs(change) <= limit
    bad = np.where(good, 0.0, memory.bad + 1.0)
    gone = bad >= allowed_bad
    stays = gone & (np.abs(modular(raw - memory.raw, period)) <= limit)
    used = np.where(good, raw, np.where(gone, np.nan, predicted))
    new_last = np.where(good | stays, raw, np.where(np.isfinite(predicted), predicted, memory.last))
    # A bridged reading goes on with half the slope: a long gap must not run away.
    slope = np.where(good, modular(raw - memory.last, period), np.where(stays, 0.0, 0.5 * memory.slope))
    faults = []
    for s, j in np.argwhere(~good):
        code = FaultCode.SPIKE if np.isfinite(reading[s, j]) else FaultCode.NOT_FINITE
        action = Action.CONTROLLED_STOP if gone[s, j] else Action.REPORT
        faults.append(Fault(code, int(j), float(change[s, j]), float(limit[s, j]), action))
    return used, Screen(new_last, slope, raw, np.where(stays, 0.0, bad)), faults


@dataclass(frozen=True)
class Frozen:
    """Memory of `frozen`, arrays (n,): gauge reading, its repetitions, motor position when it last changed."""

    reading: FloatArray
    repeats: FloatArray
    position: FloatArray


def frozen(
    gauge: FloatArray, position: FloatArray, memory: Frozen, limits: SensorLimits
) -> tuple[BoolArray, Frozen, list[Fault]]:
    """F03 for the gauge: equal readings while the motor moved by much more than a torque could hide."""
    moved, samples = limits.gauge_motion, limits.frozen_samples
    ordinary, repeats, start = _laws.gauge_changes(
        gauge, position, memory.reading, memory.repeats, memory.position, moved, samples
    )
    new = Frozen(gauge.copy(), repeats, start)
    if ordinary:
        return np.zeros(gauge.size, dtype=bool), new, []
    found = (np.abs(position - start) > moved) & (repeats >= samples)
    faults = [
        Fault(FaultCode.VALUE_FROZEN, int(j), float(repeats[j]), float(samples), Action.CONTROLLED_STOP)
        for j in np.flatnonzero(found)
    ]
    return found, new, faults


def at_rail(gauge: FloatArray, run: FloatArray, limits: SensorLimits) -> tuple[BoolArray, FloatArray, list[Fault]]:
    """F08: readings at the rail of the gauge. Which joints stop (n,), the new run lengths (n,), faults."""
    if _laws.all_below(gauge, limits.gauge_free):
        return np.zeros(gauge.size, dtype=bool), np.zeros(run.size), []
    free = np.abs(gauge) < limits.gauge_free
    run = np.where(free | np.isnan(gauge), 0.0, run + 1.0)
    stops = run >= limits.rail_samples
    faults = [
        Fault(
            FaultCode.GAUGE_RAIL,
            int(j),
            float(gauge[j]),
            float(limits.gauge_rail[j]),
            Action.CONTROLLED_STOP if stops[j] else Action.REPORT,
        )
        for j in np.flatnonzero(run > 0.0)
    ]
    return stops, run, faults


def disagree(
    motor: FloatArray, joint: FloatArray, run: FloatArray, limits: SensorLimits
) -> tuple[BoolArray, FloatArray, list[Fault]]:
    """F07: motor and joint position further apart than any twist. Which joints stop, the new run lengths, faults."""
    if _laws.all_near(motor, joint, limits.twist_limit):
        return np.zeros(motor.size, dtype=bool), np.zeros(run.size), []
    difference = motor - joint
    near = np.abs(difference) <= limits.twist_limit
    run = np.where(near | np.isnan(difference), 0.0, run + 1.0)
    stops = run >= limits.disagree_samples
    faults = [
        Fault(
            FaultCode.POSITION_DISAGREE,
            int(j),
            float(difference[j]),
            float(limits.twist_limit[j]),
            Action.CONTROLLED_STOP,
        )
        for j in np.flatnonzero(stops)
    ]
    return stops, run, faults


@dataclass(frozen=True)
class Redundancy:
    """Memory of `redundancy`, arrays (n,): way since the start, integrals over it, results of the last whole turn."""

    angle: FloatArray
    terms: FloatArray
    travel: FloatArray
    sums: FloatArray
    mean: FloatArray
    ripple: FloatArray


def first_redundancy(motor_shaft: FloatArray) -> Redundancy:
    """Nothing observed yet: `mean` and `ripple` are not a number until the motor has made a turn."""
    n = motor_shaft.size
    nothing = np.full(n, np.nan)
    sums = np.zeros((4, n))
    return Redundancy(motor_shaft.copy(), np.full((3, n), np.nan), np.zeros(n), sums, nothing, nothing.copy())


def redundancy(
    residual: FloatArray, motor_shaft: FloatArray, gauge_angle: FloatArray, memory: Redundancy, limits: SensorLimits
) -> tuple[Redundancy, list[Fault]]:
    """F09 and F10: `residual` (n,) N m, torque of the gauge minus torque of the twist, over the motor's angle.

    Integrated by trapezoids over the net way: motion back takes away again what motion forth has added, and a turn
    counts only if the way was not much longer. Over whole turns of the motor kinematic error and quantisation cancel in
    the mean; the 2 beta part reappears when a branch of Hashimoto's bridge is open. At standstill nothing is observed,
    and nothing is called healthy.
    """
    step = motor_shaft - memory.angle
    if not (_laws.all_finite(step) and _laws.all_finite(residual)):
        return replace(first_redundancy(motor_shaft), mean=memory.mean, ripple=memory.ripple), []
    ordinary, terms, sums, travel = _laws.sum_turn(
        residual, motor_shaft, gauge_angle, memory.angle, memory.terms, memory.sums, memory.travel,
        WHOLE_TURN, LONGEST_WAY, LARGEST_STEP,
    )  # fmt: skip
    mean, ripple, faults = memory.mean, memory.ripple, []
    if not ordinary:
        whole = np.abs(travel) >= WHOLE_TURN
        # Motion to and fro adds the hysteresis of every loop, fast motion steps over the ripple: the sums begin anew.
        astray = (~whole & (sums[3] > LONGEST_WAY)) | (np.abs(step) > LARGEST_STEP)
        whole &= ~astray
        way = np.where(whole, travel, 1.0)
        mean = np.where(whole, sums[0] / way, mean)
        ripple = np.where(whole, 2.0 * np.hypot(sums[1], sums[2]) / np.abs(way), ripple)
        faults = _judge_turn(whole, mean, ripple, limits)
        over = whole | astray
        travel, sums = np.where(over, 0.0, travel), np.where(over, 0.0, sums)
    return Redundancy(motor_shaft.copy(), terms, travel, sums, mean, ripple), faults


def _judge_turn(whole: BoolArray, mean: FloatArray, ripple: FloatArray, limits: SensorLimits) -> list[Fault]:
    """Faults of the joints that have just made a whole turn."""
    faults = []
    for code, values, bounds in (
        (FaultCode.GAUGE_DRIFT, mean, limits.residual_limit),
        (FaultCode.GAUGE_BRANCH, ripple, limits.ripple_limit),
    ):
        for j in np.flatnonzero(whole & ~(np.abs(values) <= bounds)):
            action = Action.REPORT if np.abs(values[j]) <= STOP_SHARE * bounds[j] else Action.CONTROLLED_STOP
            faults.append(Fault(code, int(j), float(values[j]), float(bounds[j]), action))
    return faults


# ----------------------------------------------------------------------------------------------------
# F03 for the two position sensors: one repeats a reading while the others show that it ought to have moved.
#
# A position sensor at rest repeats itself, so repetition alone says nothing. Motor position phi, joint position q and
# gauge torque tau are tied by the spring, phi - q = tau / k: each position is expected from the other one and the
# torque, also when a blocked joint winds the spring up. Kinematic error and hysteresis stay in the expectation; the
# limit allows for them. And the other position must have moved itself: a gauge that drifts at standstill is no motion.
#
# A gauge that repeats itself is found by `sensor_monitors.frozen`.


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
    ordinary, repeats, expected, other, moved = _laws.missed_motion(
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
