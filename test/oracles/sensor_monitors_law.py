"""Monitors of the three sensors of a joint once more, in plain numpy: F03 to F05 and F07 to F10 as functions on arrays.

Rows of a reading are encoder (output side, rad), resolver (rad) and gauge bridge (N m), columns are joints. Each
function takes its memory and returns the new one; nothing is skipped because a sample is ordinary.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.faults import Action, Fault, FaultCode

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


# ---- F45: motor temperatures ---------------------------------------------------------------------------------------


class Temperatures:
    """Memory of one joint's temperature: the one in use, NaN while none was usable, and K by which it may change now.

    The reserve grows at the fastest rate up to what a motor can change in `WARM_RESERVE`.
    """

    WARM_RESERVE = 1.0
    """s"""

    def __init__(self):
        self.used, self.reserve = math.nan, 0.0

    def step(self, given, limits, dt):
        """The temperature to use, and (value, limit) of a finding or None. `limits`: GuardLimits."""
        rate = float(limits.motor_temperature_rate)
        low, high = float(limits.motor_temperature_low), float(limits.motor_temperature_high)
        self.reserve = min(rate * self.WARM_RESERVE, self.reserve + rate * dt)
        if given == self.used or (math.isnan(given) and math.isnan(self.used)):
            return self.used, None
        if not low <= given <= high:
            return self.used, (given, low if given < low else high)
        if math.isnan(self.used):
            self.used, self.reserve = given, rate * self.WARM_RESERVE
            return given, None
        before, change = self.used, given - self.used
        if abs(change) <= self.reserve:
            self.used, self.reserve = given, self.reserve - abs(change)
            return given, None
        self.used, self.reserve = before + math.copysign(self.reserve, change), 0.0
        return self.used, (given, before)


# ---- F04 and F05: readings that jump or are no numbers -----------------------------------------------------------


@dataclass(frozen=True)
class Screen:
    """Memory of `screen`, arrays (3, n): last accepted reading, slope per sample, last raw reading, bad in a row."""

    last: np.ndarray
    slope: np.ndarray
    raw: np.ndarray
    bad: np.ndarray


def first_screen(reading):
    """The memory after the first reading (3, n)."""
    zeros = np.zeros_like(reading)
    return Screen(_finite(reading), zeros, _finite(reading), zeros)


def _finite(reading):
    """A copy in which everything that is no finite number is NaN."""
    return np.where(np.isfinite(reading), reading, np.nan)


def modular(difference, period):
    """The difference of two readings of counters that wrap at `period`; 0: they do not."""
    wraps = period > 0.0
    turns = np.rint(np.divide(difference, period, out=np.zeros_like(difference), where=wraps))
    return np.where(wraps, difference - period * turns, difference)


def screen(reading, memory, limit, period, allowed_bad):
    """Readings (3, n) to use, the new memory, faults. `limit` (3, n): largest jump against the prediction.

    `period` (3, n): counters wrap at it; 0: they do not.
    """
    predicted, raw = memory.last + memory.slope, _finite(reading)
    change = modular(reading - predicted, period)
    good = np.abs(change) <= limit
    bad = np.where(good, 0.0, memory.bad + 1.0)
    gone = bad >= allowed_bad
    stays = gone & (np.abs(modular(raw - memory.raw, period)) <= limit)
    used = np.where(good, raw, np.where(gone, np.nan, predicted))
    last = np.where(good | stays, raw, np.where(np.isfinite(predicted), predicted, memory.last))
    # A bridged reading goes on with half the slope: a long gap must not run away.
    slope = np.where(good, modular(raw - memory.last, period), np.where(stays, 0.0, 0.5 * memory.slope))
    faults = []
    for s, j in np.argwhere(~good):
        code = FaultCode.SPIKE if np.isfinite(reading[s, j]) else FaultCode.NOT_FINITE
        action = Action.CONTROLLED_STOP if gone[s, j] else Action.REPORT
        faults.append(Fault(code, int(j), float(change[s, j]), float(limit[s, j]), action))
    return used, Screen(last, slope, raw, np.where(stays, 0.0, bad)), faults


# ---- F07 and F08: sensors that disagree, a gauge at its rail -----------------------------------------------------


def disagree(motor, joint, run, limits):
    """F07: motor and joint position further apart than any twist. Which joints stop, the new run lengths, faults."""
    difference = motor - joint
    near = (np.abs(difference) <= limits.twist_limit) | np.isnan(difference)
    run = np.where(near, 0.0, run + 1.0)
    stops = run >= limits.disagree_samples
    faults = [
        Fault(FaultCode.POSITION_DISAGREE, int(j), float(difference[j]), float(limits.twist_limit[j]),
              Action.CONTROLLED_STOP)
        for j in np.flatnonzero(stops)
    ]  # fmt: skip
    return stops, run, faults


def at_rail(gauge, run, limits):
    """F08: readings at the rail of the gauge. Which joints stop (n,), the new run lengths (n,), faults."""
    free = (np.abs(gauge) < RAIL_SHARE * limits.gauge_rail) | np.isnan(gauge)
    run = np.where(free, 0.0, run + 1.0)
    stops = run >= limits.rail_samples
    faults = [
        Fault(FaultCode.GAUGE_RAIL, int(j), float(gauge[j]), float(limits.gauge_rail[j]),
              Action.CONTROLLED_STOP if stops[j] else Action.REPORT)
        for j in np.flatnonzero(~free)
    ]  # fmt: skip
    return stops, run, faults


# ---- F03 for the gauge: equal readings while the motor moved by much more than a torque could hide ---------------


@dataclass(frozen=True)
class Frozen:
    """Memory of `frozen`, arrays (n,): gauge reading, its repetitions, motor position when it last changed."""

    reading: np.ndarray
    repeats: np.ndarray
    position: np.ndarray


def frozen(gauge, position, memory, limits):
    """Which joints stop (n,), the new memory, faults."""
    same = gauge == memory.reading
    repeats = np.where(same, memory.repeats + 1.0, 0.0)
    start = np.where(same, memory.position, position)
    found = (np.abs(position - start) > MOVED_COUNTS * limits.twist_limit) & (repeats >= limits.frozen_samples)
    faults = [
        Fault(FaultCode.VALUE_FROZEN, int(j), float(repeats[j]), float(limits.frozen_samples), Action.CONTROLLED_STOP)
        for j in np.flatnonzero(found)
    ]
    return found, Frozen(gauge.copy(), repeats, start), faults


# ---- F09 and F10: torque of the gauge minus torque of the twist, over whole turns of the motor -------------------


@dataclass(frozen=True)
class Redundancy:
    """Memory of `redundancy`, arrays (n,): way since the start, integrals over it, results of the last whole turn."""

    angle: np.ndarray
    terms: np.ndarray
    travel: np.ndarray
    sums: np.ndarray
    mean: np.ndarray
    ripple: np.ndarray


def first_redundancy(motor_shaft):
    """Nothing observed yet: `mean` and `ripple` are not a number until the motor has made a turn."""
    n = motor_shaft.size
    nothing = np.full(n, np.nan)
    return Redundancy(motor_shaft.copy(), np.full((3, n), np.nan), np.zeros(n), np.zeros((4, n)), nothing, nothing)


def _each(function, angles):
    """A function of `math`, whose bits are those of the compiled side; numpy's own sine may differ in the last one."""
    return np.array([function(angle) if math.isfinite(angle) else math.nan for angle in angles.tolist()])


def redundancy(residual, motor_shaft, gauge_angle, memory, limits):
    """`residual` (n,) N m against the motor's angle, rad. Returns the new memory and faults.

    Integrated by trapezoids over the net way: motion back takes away again what motion forth has added, and a turn
    counts only if the way was not much longer. Over whole turns kinematic error and quantisation cancel in the mean;
    the 2 beta part reappears when a branch of Hashimoto's bridge is open. At standstill nothing is observed.
    """
    step = motor_shaft - memory.angle
    if not (np.isfinite(step).all() and np.isfinite(residual).all()):
        return replace(first_redundancy(motor_shaft), mean=memory.mean, ripple=memory.ripple), []
    cosine, sine = _each(math.cos, 2.0 * gauge_angle), _each(math.sin, 2.0 * gauge_angle)
    terms = np.stack([residual, residual * cosine, residual * sine])
    before = np.where(np.isnan(memory.terms), terms, memory.terms)
    sums = memory.sums + np.vstack([0.5 * (before + terms) * step, np.abs(step)])
    travel = memory.travel + step
    whole = np.abs(travel) >= WHOLE_TURN
    # Motion to and fro adds the hysteresis of every loop, fast motion steps over the ripple: the sums begin anew.
    astray = (~whole & (sums[3] > LONGEST_WAY)) | (np.abs(step) > LARGEST_STEP)
    whole = whole & ~astray
    way = np.where(whole, travel, 1.0)
    mean = np.where(whole, sums[0] / way, memory.mean)
    ripple = np.where(whole, 2.0 * np.hypot(sums[1], sums[2]) / np.abs(way), memory.ripple)
    over = whole | astray
    new = Redundancy(
        motor_shaft.copy(), terms, np.where(over, 0.0, travel), np.where(over, 0.0, sums), mean, ripple
    )  # fmt: skip
    return new, judge_turn(whole, mean, ripple, limits)


def judge_turn(whole, mean, ripple, limits):
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


# ---- F03 for the two position sensors: one repeats a reading while the others show that it ought to have moved ---
#
# A position sensor at rest repeats itself, so repetition alone says nothing. Motor position phi, joint position q and
# gauge torque tau are tied by the spring, phi - q = tau / k: each position is expected from the other one and the
# torque, also when a blocked joint winds the spring up. And the other position must have moved itself: a gauge that
# drifts at standstill is no motion.


@dataclass(frozen=True)
class Stuck:
    """Memory, arrays (2, n) of encoder and resolver: reading, its repetitions; when it changed last: what was expected,
    and the other reading.
    """

    reading: np.ndarray
    repeats: np.ndarray
    expected: np.ndarray
    other: np.ndarray


def first_stuck(positions):
    """The memory after the first positions (2, n)."""
    return Stuck(positions.copy(), np.zeros_like(positions), np.full_like(positions, np.nan), positions[::-1].copy())


def stuck(positions, twist, memory, samples, limit, step):
    """Motion that was missed (n,) rad, the larger of both sensors, the new memory, faults.

    `positions` (2, n) rad at the output side: motor, joint. `twist` (n,) rad: gauge torque over stiffness, less the
    known kinematic error. `samples` equal readings and more than `limit` (n,) rad of expected motion stop the robot;
    `step` samples lie between two calls. Numbers that are not finite expect nothing.
    """
    other_now = positions[::-1]
    now = other_now + np.stack([twist, -twist])
    same = positions == memory.reading
    repeats = np.where(same, memory.repeats + step, 0.0)
    expected = np.where(same & np.isfinite(memory.expected), memory.expected, now)
    other = np.where(same, memory.other, other_now)
    least = np.minimum(np.abs(now - expected), np.abs(other_now - other))  # NaN if one of them is
    moved = np.where(repeats >= samples, least, 0.0)
    faults = [
        Fault(FaultCode.VALUE_FROZEN, int(j), float(repeats[s, j]), float(samples), Action.CONTROLLED_STOP)
        for s, j in np.argwhere(moved > limit)
    ]
    return moved.max(axis=0), Stuck(positions.copy(), repeats, expected, other), faults
