"""Monitors around the torque law once more, in plain numpy: lost ticks (F01), gauge at its rail (F08), F34."""

import numpy as np

from hd_control.core.blocks import layout_of
from hd_control.core.faults import Action, Fault, FaultCode

ESTIMATES = {
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


def initial(joints):
    """Nothing at a bound."""
    return layout_of("AdaptationWatch", _FIELDS, joints).zeros()


def lost_ticks(gap, level, limits):
    """F01: what `gap` lost ticks before this one demand: report, degrade, stop. Returns the new level and faults.

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


def gauge_rail(torque, run, limits):
    """F08 as the law sees it: joint torque (n,) at the rail, a few in a row, degrades; fusion stops after more of them.

    `limits`: GuardLimits. Returns the new run lengths and faults.
    """
    free = (np.abs(torque) < RAIL_SHARE * limits.gauge_rail) | np.isnan(torque)
    run = np.where(free, 0.0, run + 1.0)
    return run, [
        Fault(FaultCode.GAUGE_RAIL, int(j), float(torque[j]), float(limits.gauge_rail[j]), Action.DEGRADE)
        for j in np.flatnonzero(run >= limits.rail_degrade_samples)
    ]


def watch(memory, state, params, sample, reference, limits, dt):
    """F34 of one look. `dt` s between two looks; blocks of the adaptive law, `limits`: GuardLimits.

    An estimate at its bound is normal work of the projection. It becomes a fault when it lasts and the error grows.
    """
    new, found = memory.copy(), []
    for j in range(state.joints):
        with np.errstate(invalid="ignore"):
            error = np.abs(reference.desired_position[j] - sample.joint_position[j])
        new.error[j] += (error - new.error[j] if np.isfinite(error) else 0.0) / ERROR_SAMPLES
        mean, at_bound = new.error[j], False
        for name, stem in ESTIMATES.items():
            value, low, high = state.view(name)[j], params.view(f"{stem}_low")[j], params.view(f"{stem}_high")[j]
            at_bound |= bool((value <= low or value >= high) and low < high)
        if at_bound and new.time_at_bound[j] == 0.0:
            new.error_at_bound[j] = mean
        new.time_at_bound[j] = new.time_at_bound[j] + dt if at_bound else 0.0
        if not (new.time_at_bound[j] > limits.adaptation_time and mean > SMALLEST_ERROR):
            continue
        growth = float(mean / np.fmax(new.error_at_bound[j], SMALLEST_ERROR / STOP_GROWTH))
        if growth >= DEGRADE_GROWTH:
            action = Action.CONTROLLED_STOP if growth >= STOP_GROWTH else Action.DEGRADE
            found.append(Fault(FaultCode.ADAPTATION, j, growth, DEGRADE_GROWTH, action))
    return new, found
