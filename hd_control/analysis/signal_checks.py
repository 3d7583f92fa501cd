"""Sanity of a joint's signals before anything is concluded from them: signs, units, gear ratio, wraps, delays, limits.

Every sentence names what is seen and what it probably means. A check speaks only where the recording decides it: a
poor recording gets no sentence, which is not a certificate. The thresholds were set on random simulated joints whose
signals are right (good and poor recordings, every hidden effect) so that none of them is called wrong.
"""

from __future__ import annotations

import numpy as np

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
FLIPPED_LINK, FLIPPED_DRIVE = -10.0, -3.0
"""Largest t value of the inertia (gauge) and of inertia and friction (motor torque) that counts as a turned sign."""
SCALE_ERROR, SCALE_RANGE, SCALE_REST = 0.05, (0.15, 7.0), 0.3
FACTORS = {1e3: "1000, as N m and mN m", 1e-3: "0.001, as N m and kN m"}


def check_signals(signals: JointSignals, gear_ratio: float, rated_torque: float | None = None) -> tuple[str, ...]:
    """What looks wrong with the signals of one joint, one sentence each; empty if nothing does.

    gear_ratio and rated_torque (N m, output side) are those of the model.
    """
    wraps, continuous = unwrapped(signals)
    angles, units = degrees(continuous), torque_units(signals, gear_ratio, rated_torque)
    found = [*wraps, *angles, *units, *stuck(continuous, gear_ratio), *temperature(signals), *saturated(signals)]
    moving = [name for name in POSITIONS if name in signals.present and extent(getattr(continuous, name)) > 0.0]
    if not moving or signals.time.size * signals.period < SHORTEST:
        return tuple(found)
    rows = SlowRows(_without(continuous, moving), gear_ratio)
    if int(rows.usable.sum()) < FEWEST_ROWS:
        return tuple(found)
    ratio = [] if angles else _ratio(rows, gear_ratio)
    signs = _signs(rows)
    scale = [] if signs or units else _scale(rows, gear_ratio)
    delays = [] if any((wraps, angles, units, ratio, signs, scale)) else delay_sentences(rows)
    return (*found, *ratio, *signs, *scale, *delays)


def _without(signals: JointSignals, moving: list[str]) -> JointSignals:
    """The signals without positions that do not move."""
    gone = [name for name in POSITIONS if name not in moving]
    for name in gone:
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
    """Torques that do work in the wrong direction: inertia and friction must come out positive."""
    found = []
    columns = [*rows.link(), *rows.friction()]
    if "gauge_torque" in rows.present:
        fit = regress(rows.rows("gauge_torque"), columns, rows.usable)
        if fit.t(0) < FLIPPED_LINK and fit.rest < SCALE_REST * fit.spread:
            found.append("the sign of gauge_torque looks flipped: with it the link's inertia comes out negative")
    if "motor_torque" in rows.present:
        fit = regress(rows.rows("motor_torque"), columns, rows.usable)
        if fit.t(0) < FLIPPED_DRIVE and fit.t(4) < FLIPPED_DRIVE:
            found.append("the sign of motor_torque looks flipped: with it inertia and friction come out negative")
    return found


def _scale(rows: SlowRows, gear_ratio: float) -> list[str]:
    """motor_torque = c gauge_torque + inertia + friction; c is 1 if both are N m at the output."""
    if not {"gauge_torque", "motor_torque"} <= rows.present:
        return []
    columns = [rows.rows("gauge_torque"), rows.rows(rows.position, 2), *rows.friction(), np.ones(rows.usable.size)]
    fit = regress(rows.rows("motor_torque"), columns, rows.usable)
    c, error = float(fit.coefficients[0]), float(fit.errors[0])
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
