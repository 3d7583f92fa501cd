"""Sanity of a joint's signals before anything is concluded from them: signs, units, gear ratio, wraps, delays, limits.

Every sentence names what is seen and what it probably means. A check speaks only where the recording decides it: a
poor recording gets no sentence, which is not a certificate. The thresholds were set on random simulated joints whose
signals are right (good and poor recordings, every hidden effect) so that none of them is called wrong.
"""

from __future__ import annotations

import numpy as np

from hd_control.analysis.collector import MEASURED
from hd_control.analysis.column_checks import (
    POSITIONS,
    degrees,
    extent,
    saturated,
    stuck,
    temperature,
    torque_units,
    unwrapped,
    with_column,
)
from hd_control.analysis.delay_checks import delay_sentences
from hd_control.analysis.signals import JointSignals
from hd_control.analysis.slow_rows import FEWEST_ROWS, SlowRows, regress
from hd_control.analysis.sources import DEGREE

SHORTEST = 2.0
"""s below which nothing is said of the motion."""
RATIO_TOLERANCE, TORSION = (1e-3, 1e-3), (3e-3, 6e-3)
"""(relative, rad over the range of motion) of the slope between the positions, with and without the gauge's torsion."""
LEAST_MOTION = 5e-3
FLIPPED_INERTIA, FLIPPED_POWER = -10.0, {"gauge_torque": -12.0, "motor_torque": -4.0}
"""t values of inertia and friction power below which a torque counts as turned; the gauge may see little friction."""
CLEAR_POWER, CLEAR_INERTIA = 8.0, 15.0
"""t values above which the other one contradicts: on a slow joint a late torque looks like negative inertia."""
LEAST_DRIVEN = 0.1
"""rad of motion below which a joint may only be pushed by its neighbours; its torque says nothing of its sign then."""
SCALE_ERROR, SCALE_RANGE, SCALE_REST = 0.05, (0.15, 7.0), 0.3
FACTORS = {1e3: "1000, as N m and mN m", 1e-3: "0.001, as N m and kN m"}


def check_signals(signals: JointSignals, gear_ratio: float, rated_torque: float | None = None) -> tuple[str, ...]:
    """What looks wrong with the signals of one joint, one sentence each; empty if nothing does.

    gear_ratio and rated_torque (N m, output side) are those of the model.
    """
    wraps, continuous = unwrapped(signals)
    angles, units = degrees(continuous), torque_units(signals, gear_ratio, rated_torque)
    found = [*wraps, *angles, *units, *stuck(continuous, gear_ratio), *temperature(signals), *saturated(signals)]
    moving = _moving(continuous)
    if not {*POSITIONS} & {*moving.present} or signals.time.size * signals.period < SHORTEST:
        return tuple(found)
    rows = SlowRows(moving, gear_ratio)
    if int(rows.usable.sum()) < FEWEST_ROWS:
        return tuple(found)
    ratio = [] if angles else _ratio(rows, gear_ratio)
    signs = _signs(rows)
    scale = [] if signs or units else _scale(rows, gear_ratio)
    delays = [] if any((wraps, angles, units, ratio, signs, scale)) else delay_sentences(rows)
    return (*found, *ratio, *signs, *scale, *delays)


def _moving(signals: JointSignals) -> JointSignals:
    """The signals without columns that never change."""
    for name in MEASURED:
        if getattr(signals, name) is not None and extent(getattr(signals, name)) == 0.0:
            signals = with_column(signals, name, None)
    return signals


def _ratio(rows: SlowRows, gear_ratio: float) -> list[str]:
    """The slope between the positions against the gear ratio of the model."""
    if not {*POSITIONS} <= rows.present:
        return []
    joint = rows.rows("joint_position")
    span = float(np.ptp(joint[rows.usable]))
    motor_span = float(np.ptp(rows.rows("motor_shaft_position")[rows.usable]))
    if span < LEAST_MOTION or motor_span < LEAST_MOTION / gear_ratio:
        return []
    with_gauge = "gauge_torque" in rows.present
    columns = [joint, np.ones(joint.size)] + ([rows.rows("gauge_torque")] if with_gauge else [])
    fit = regress(rows.rows("motor_shaft_position"), columns, rows.usable)
    slope = float(fit.coefficients[0])
    relative, torsion = RATIO_TOLERANCE if with_gauge else TORSION
    if abs(slope - 1.0) <= max(relative, torsion / span) or fit.rest > 0.1 * fit.spread:
        return []
    found = gear_ratio * slope
    for meant, text in (
        (1.0 / gear_ratio, "motor_shaft_position looks already divided by the gear ratio"),
        (DEGREE, "joint_position looks like degrees, motor_shaft_position like rad"),
        (1.0 / DEGREE, "motor_shaft_position looks like degrees, joint_position like rad"),
    ):
        if abs(slope / meant - 1.0) < 0.1:
            return [f"{text}: it turns {found:.5g} per joint_position, the model's gear ratio is {gear_ratio:g}"]
    if slope < 0.0:
        return [
            f"motor_shaft_position and joint_position have opposite signs: slope {found:.5g}, "
            f"the model's gear ratio is {gear_ratio:g}"
        ]
    return [
        f"the gear ratio in the model is wrong: the motor turns {found:.6g} per joint turn, "
        f"the model says {gear_ratio:g}"
    ]


def _signs(rows: SlowRows) -> list[str]:
    """Torques that work in the wrong direction: the inertia and the power of the friction must come out positive."""
    found: list[str] = []
    if float(np.ptp(rows.rows(rows.position)[rows.usable])) < LEAST_DRIVEN:
        return found
    friction, velocity = rows.friction(), rows.rows(rows.position, 1)
    columns = [*rows.link(), *friction]
    weights = np.zeros(len(columns))
    weights[-2:] = [float(np.mean((column * velocity)[rows.usable])) for column in friction]
    for name, limit in FLIPPED_POWER.items():
        if name not in rows.present:
            continue
        fit = regress(rows.rows(name), columns, rows.usable)
        inertia, power = fit.t(0), fit.t_of(weights)
        backwards = inertia < FLIPPED_INERTIA and power < CLEAR_POWER and fit.rest < SCALE_REST * fit.spread
        if backwards or (power < limit and inertia < CLEAR_INERTIA):
            what = " and ".join(word for word, t in (("inertia", inertia), ("friction", power)) if t < 0.0)
            found.append(f"the sign of {name} looks flipped: with it {what} come out negative")
    return found


def _scale(rows: SlowRows, gear_ratio: float) -> list[str]:
    """motor_torque = c gauge_torque + inertia + friction; c is 1 if both are N m at the output."""
    if not {"gauge_torque", "motor_torque"} <= rows.present:
        return []
    columns = [rows.rows("gauge_torque"), rows.rows(rows.position, 2), *rows.friction(), np.ones(rows.usable.size)]
    fit = regress(rows.rows("motor_torque"), columns, rows.usable)
    c, error = float(fit.coefficients[0]), fit.error(0)
    if error > SCALE_ERROR * max(abs(c), 1.0 / gear_ratio) or fit.rest > SCALE_REST * fit.spread or fit.t(1) < 0.0:
        return []
    if SCALE_RANGE[0] <= abs(c) <= SCALE_RANGE[1]:
        return []
    if 0.5 <= abs(c) * gear_ratio <= 2.0:
        return [
            f"motor_torque is {abs(c):.3g} of what balances gauge_torque: "
            f"it looks like the torque of the motor itself, not times the gear ratio {gear_ratio:g}"
        ]
    near = next((text for factor, text in FACTORS.items() if 0.6 < abs(c) / factor < 1.6), f"{abs(c):.3g}")
    return [f"motor_torque and gauge_torque differ by a factor of {near}: check their units"]
