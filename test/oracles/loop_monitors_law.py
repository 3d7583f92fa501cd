"""Monitors around the torque law: lost ticks (F01, F17), gauge at its rail (F08), estimates at their bounds (F34)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from hd_control import _laws
from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.laws import torque
from hd_control.safety.limits import SafetyLimits

ESTIMATES: Mapping[str, str] = {
    "coulomb_torque": "coulomb_torque",
    "friction_offset": "friction_offset",
    "viscous_positive": "viscous",
    "viscous_negative": "viscous",
    "torsional_compliance": "torsional_compliance",
}
"""Estimates of the adaptive torque law, with the stem of their bounds."""
DEGRADE_GROWTH, STOP_GROWTH = 2.0, 4.0
SMALLEST_ERROR = 0.01
"""rad; a smaller tracking error is no reason to act, however it grew."""
ERROR_SAMPLES = 10.0
RAIL_SHARE = 0.99
FORGIVEN = 0.1
"""Share of a lost tick that each tick that comes makes good."""
_FIELDS = (
    ("error", 1, "rad", "mean tracking error over about 10 looks"),
    ("time_at_bound", 1, "s", "since an estimate of the joint is at its bound"),
    ("error_at_bound", 1, "rad", "error when that began"),
)


@lru_cache
def _layout(joints: int) -> Layout:
    return layout_of("AdaptationWatch", _FIELDS, joints)


def initial(joints: int) -> Block:
    """Nothing at a bound."""
    return _layout(joints).zeros()


def lost_ticks(gap: int, level: float, limits: SafetyLimits) -> tuple[float, list[Fault]]:
    """What `gap` lost ticks before this one demand: report, degrade, stop. Returns the new level and faults.

    `level` is what was lost and is not forgiven yet; every tick that comes forgives a tenth. So ten lost in a row stop
    the robot, and so does every second one lost for 25 ticks: the laws count on their period.
    """
    level = level - FORGIVEN if level > FORGIVEN else 0.0
    if gap <= 0:
        return level, []
    level += gap
    action, bound = Action.REPORT, 1.0
    if level >= limits.gate.age_limit:
        action, bound = Action.CONTROLLED_STOP, float(limits.gate.age_limit)
    elif gap >= limits.guard.degrade_gap_samples:
        action, bound = Action.DEGRADE, float(limits.guard.degrade_gap_samples)
    return level, [Fault(FaultCode.FRAME_LOST, -1, level, bound, action)]


def gauge_rail(torque: FloatArray, run: FloatArray, limits: Block) -> tuple[FloatArray, list[Fault]]:
    """F08 as the law sees it: joint torque (n,) at the rail, a few in a row, degrades; fusion stops after more of them.

    `limits`: GuardLimits. Returns the new run lengths and faults.
    """
    rail = RAIL_SHARE * limits.gauge_rail
    if _laws.all_below(torque, rail):
        return np.zeros(run.size), []
    free = np.abs(torque) < rail
    run = np.where(free | np.isnan(torque), 0.0, run + 1.0)
    return run, [
        Fault(FaultCode.GAUGE_RAIL, int(j), float(torque[j]), float(limits.gauge_rail[j]), Action.DEGRADE)
        for j in np.flatnonzero(run >= limits.rail_degrade_samples)
    ]


@lru_cache
def _places(joints: int) -> tuple[IntArray, IntArray, IntArray]:
    """Where estimates lie in the array of the law's state, their bounds in that of its parameters: (5, n) each."""
    parameters, state = torque.layout("TorqueParams", joints).slices, torque.layout("TorqueState", joints).slices
    return (
        np.array([np.r_[state[name]] for name in ESTIMATES]),
        np.array([np.r_[parameters[f"{stem}_low"]] for stem in ESTIMATES.values()]),
        np.array([np.r_[parameters[f"{stem}_high"]] for stem in ESTIMATES.values()]),
    )


def watch(
    memory: Block, state: Block, params: Block, sample: Block, reference: FloatArray, limits: Block, dt: float
) -> tuple[Block, list[Fault]]:
    """F34 of one sample. `reference`: array of the law's reference block, whose second part is the desired position.

    An estimate at its bound is normal work of the projection. It becomes a fault when it lasts and the error grows.
    """
    new, n = memory.copy(), state.joints
    with np.errstate(invalid="ignore"):
        error = np.abs(reference[n : 2 * n] - sample.joint_position)
    mean, since, error_then = new.error, new.time_at_bound, new.error_at_bound
    mean += np.where(np.isfinite(error), error - mean, 0.0) / ERROR_SAMPLES
    own, low_at, high_at = _places(n)
    values, low, high = state.array[own], params.array[low_at], params.array[high_at]
    at_bound = (((values <= low) | (values >= high)) & (low < high)).any(axis=0)
    np.copyto(error_then, mean, where=at_bound & (since == 0.0))
    since[:] = np.where(at_bound, since + dt, 0.0)
    long = (since > limits.adaptation_time) & (mean > SMALLEST_ERROR)
    if not long.any():
        return new, []
    growth = mean / np.fmax(error_then, SMALLEST_ERROR / STOP_GROWTH)
    found = []
    for j in np.flatnonzero(long & (growth >= DEGRADE_GROWTH)):
        action = Action.CONTROLLED_STOP if growth[j] >= STOP_GROWTH else Action.DEGRADE
        found.append(Fault(FaultCode.ADAPTATION, int(j), float(growth[j]), DEGRADE_GROWTH, action))
    return new, found
