"""Sanity of a joint's signals before anything is concluded from them: signs, units, gear ratio, wraps, delays, limits.

Every sentence names what is seen and what it probably means. A check speaks only where the recording decides it: a
poor recording gets no sentence, which is not a certificate. The thresholds were set on random simulated joints whose
signals are right (good and poor recordings, every hidden effect) so that none of them is called wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.lab.signals.delays import (
    FEWEST_ROWS,
    POSITIONS,
    KnownLinks,
    MeasuredDelay,
    SlowRows,
    delay_sentences,
    measured_delays,
    position_shift,
    regress,
)
from hd_control.lab.signals.joint_signals import JointSignals
from hd_control.lab.signals.recording import MEASURED
from hd_control.lab.signals.sources import DEGREE

# ---- Single columns: wraps, units, stuck and saturated signals, temperatures -----------------------


JOINT_TURNS = 4.0 * np.pi
"""rad beyond which a joint angle is more likely in degrees."""
JOINT_SPEED, MOTOR_SPEED = 12.0, 1500.0
"""rad/s beyond which a speed is more likely in degrees per second."""
STUCK_S, STUCK_MOTION = 0.2, 0.02
"""A position that stays equal this long while the other one moves by so many rad is stuck."""
KELVIN, FAHRENHEIT = (200.0, 450.0), (120.0, 200.0)
SATURATED_PERCENT, SATURATED_RUN = 0.05, 5


def extent(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def with_column(signals: JointSignals, name: str, column: FloatArray | None) -> JointSignals:
    """The signals with another column."""
    columns: dict[str, Any] = {name: column}
    return replace(signals, **columns)


def unwrapped(signals: JointSignals) -> tuple[list[str], JointSignals]:
    """Positions that start anew after a turn, and the signals with continuous ones."""
    found, repaired = [], signals
    for name in POSITIONS:
        column = getattr(signals, name)
        if column is None:
            continue
        finite = np.isfinite(column)
        steps, span = np.abs(np.diff(column[finite])), extent(column)
        for turn, unit in ((2.0 * np.pi, "2 pi"), (360.0, "360 degrees")):
            jumps = steps > 0.8 * turn
            if jumps.any() and span <= 1.01 * turn and float(np.max(steps[~jumps], initial=0.0)) < 0.4 * turn:
                found.append(
                    f"{name} jumps {int(jumps.sum())} times: it wraps at {unit}; "
                    f"unwrap it (in a mapping: wrap: {turn:.6g})"
                )
                values = column.copy()
                values[finite] = np.unwrap(column[finite], period=turn)
                repaired = with_column(repaired, name, values)
                break
    return found, repaired


def _speed(column: FloatArray, period: float) -> float:
    """A speed that the joint exceeds 5 % of the time, unit of the column per second."""
    steps = np.abs(np.diff(column)) / period
    return float(np.nanpercentile(steps, 95.0)) if np.isfinite(steps).any() else 0.0


def degrees(signals: JointSignals) -> list[str]:
    joint, motor = signals.joint_position, signals.motor_shaft_position
    found = []
    if joint is not None:
        largest, smooth = float(np.nanmax(np.abs(joint))), joint[:: max(1, round(0.02 / signals.period))]
        speed = _speed(smooth, signals.period * max(1, round(0.02 / signals.period)))
        if largest > JOINT_TURNS or speed > JOINT_SPEED:
            found.append(
                f"joint_position reaches {largest:.4g} at {speed:.3g} per second: it looks like degrees, not rad"
            )
    if motor is not None:
        speed = _speed(
            motor[:: max(1, round(0.02 / signals.period))], signals.period * max(1, round(0.02 / signals.period))
        )
        if speed > MOTOR_SPEED:
            found.append(f"motor_shaft_position moves at {speed:.4g} per second: it looks like degrees, not rad")
    return found


def stuck(signals: JointSignals, gear_ratio: float) -> list[str]:
    """Positions that stay exactly equal while the other one moves; torques that never change while the joint moves."""
    motor, joint = signals.motor_shaft_position, signals.joint_position
    found = []
    columns = {"motor_shaft_position": (motor, joint, 1.0), "joint_position": (joint, motor, 1.0 / gear_ratio)}
    for name, (column, other, scale) in columns.items():
        if column is None or other is None:
            continue
        start, length = _longest_equal(column)
        moved = scale * extent(other[start : start + length])
        if length * signals.period >= STUCK_S and moved > STUCK_MOTION:
            at, span = start * signals.period, length * signals.period
            found.append(
                f"{name} is stuck: it stays at {column[start]:.6g} for {span:.3g} s from {at:.3g} s on, "
                f"while the other position moves by {moved:.3g} rad"
            )
    position, scale = (joint, 1.0) if joint is not None else (motor, 1.0 / gear_ratio)
    moved = 0.0 if position is None else scale * extent(position)
    for name in ("gauge_torque", "motor_torque"):
        column = getattr(signals, name)
        if column is not None and extent(column) == 0.0 and moved > STUCK_MOTION:
            found.append(f"{name} never changes while the joint moves by {moved:.3g} rad: the signal is stuck")
    return found


def _longest_equal(column: FloatArray) -> tuple[int, int]:
    """(first index, length) of the longest run of equal values."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(column) != 0.0, [True]]))
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    return int(edges[longest]), int(lengths[longest])


def temperature(signals: JointSignals) -> list[str]:
    column = signals.temperature
    if column is None or not np.isfinite(column).any():
        return []
    middle = float(np.nanmedian(column))
    if KELVIN[0] < middle < KELVIN[1]:
        return [f"temperature is around {middle:.4g}: it looks like kelvin, not degrees Celsius"]
    if FAHRENHEIT[0] < middle <= FAHRENHEIT[1]:
        return [f"temperature is around {middle:.4g}: it looks like degrees Fahrenheit, not Celsius"]
    if middle < -50.0 or middle >= KELVIN[1]:
        return [f"temperature is around {middle:.4g}: not a motor's temperature in degrees Celsius"]
    return []


def saturated(signals: JointSignals) -> list[str]:
    """Torques that rest exactly at their extremes."""
    found = []
    for name in ("motor_torque", "gauge_torque"):
        column = getattr(signals, name)
        if column is None or extent(column) == 0.0:
            continue
        values = column[np.isfinite(column)]
        for limit in (float(values.max()), float(values.min())):
            at = np.abs(values - limit) <= 1e-9 * abs(limit)
            edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
            runs = edges[1::2] - edges[::2]
            share = 100.0 * float(runs[runs >= SATURATED_RUN].sum()) / values.size
            if share > SATURATED_PERCENT and abs(limit) > 0.5 * float(np.abs(values).max()):
                found.append(f"{name} is at its limit of {limit:.4g} N m for {share:.2g} % of the time: saturated")
    return found


def torque_units(signals: JointSignals, gear_ratio: float, rated_torque: float | None) -> list[str]:
    """Torques far from what the joint is rated for."""
    if not rated_torque:
        return []
    found = []
    for name in ("gauge_torque", "motor_torque"):
        column = getattr(signals, name)
        if column is None or extent(column) == 0.0:
            continue
        high = float(np.nanpercentile(np.abs(column), 99.0))
        if high > 30.0 * rated_torque:
            found.append(f"{name} reaches {high:.4g} at a rated torque of {rated_torque:.4g} N m: it looks like mN m")
        elif name == "motor_torque" and high < 2.0 * rated_torque / gear_ratio and high < 0.02 * rated_torque:
            found.append(
                f"motor_torque reaches only {high:.3g} N m at a rated torque of {rated_torque:.4g} N m: "
                f"it looks like the torque of the motor itself, not times the gear ratio {gear_ratio:g}"
            )
    return found


# ---- Columns against each other: gear ratio, signs, scale of the torque ----------------------------


SHORTEST = 2.0
"""s below which nothing is said of the motion."""
RATIO_TOLERANCE, TORSION = (1e-3, 1e-3), (3e-3, 6e-3)
"""(relative, rad over the range of motion) of the slope between the positions, with and without the gauge's torsion."""
LEAST_MOTION = 5e-3
OPPOSITE = "opposite signs"
FLIPPED_INERTIA, FLIPPED_POWER = -10.0, {"gauge_torque": -12.0, "motor_torque": -4.0}
"""t values of inertia and friction power below which a torque counts as turned; the gauge may see little friction."""
CLEAR_POWER, CLEAR_INERTIA = 8.0, 15.0
"""t values above which the other one contradicts: on a slow joint a late torque looks like negative inertia."""
LEAST_DRIVEN = 0.1
"""rad of motion below which a joint may only be pushed by its neighbours; its torque says nothing of its sign then."""
SCALE_ERROR, SCALE_RANGE, SCALE_REST = 0.05, (0.15, 7.0), 0.3
CLEAR_GRAVITY, GRAVITY_SHARE, GRAVITY_RANGE = 10.0, 0.03, (0.4, 20.0)
"""t value and share of the torque from which on gravity decides; parts of the described one that may be true: a load on
a light wrist is many times the wrist's own weight, but nothing takes gravity away."""
FACTORS = {1e3: "1000, as N m and mN m", 1e-3: "0.001, as N m and kN m"}


@dataclass(frozen=True)
class SignalChecks:
    """What was seen of one joint's signals: all `sentences`; those that are `contradictions` of signals and model
    (sign, gear ratio, unit, gravity), with which no name of an effect means anything; `delays`."""

    sentences: tuple[str, ...]
    contradictions: tuple[str, ...]
    delays: tuple[MeasuredDelay, ...]


def check_signals(
    signals: JointSignals, gear_ratio: float, rated_torque: float | None = None, links: KnownLinks | None = None
) -> tuple[str, ...]:
    """What looks wrong with the signals of one joint, one sentence each; empty if nothing does."""
    return examine(signals, gear_ratio, rated_torque, links).sentences


def examine(
    signals: JointSignals, gear_ratio: float, rated_torque: float | None = None, links: KnownLinks | None = None
) -> SignalChecks:
    """All checks of one joint. gear_ratio and rated_torque (N m, output side) are those of the model; `links`: what its
    robot description says of the torque."""
    wraps, continuous = unwrapped(signals)
    angles, units = degrees(continuous), torque_units(signals, gear_ratio, rated_torque)
    found = [*wraps, *angles, *units, *stuck(continuous, gear_ratio), *temperature(signals), *saturated(signals)]
    moving = _moving(continuous)
    if not {*POSITIONS} & {*moving.present} or signals.time.size * signals.period < SHORTEST:
        return SignalChecks(tuple(found), (*angles, *units), ())
    rows = SlowRows(moving, gear_ratio, links)
    if int(rows.usable.sum()) < FEWEST_ROWS:
        return SignalChecks(tuple(found), (*angles, *units), ())
    ratio = [] if angles else _ratio(rows, gear_ratio)
    signs = [] if OPPOSITE in "".join(ratio) else _signs(rows)  # against a position that is turned both torques are
    scale = [] if signs or units else _scale(rows, gear_ratio)
    scale = scale or ([] if signs or units or angles else _gravity(rows, gear_ratio))
    wrong = (*angles, *units, *ratio, *signs, *scale)
    delays = [] if wraps or wrong else delay_sentences(rows)
    measured = () if wraps or wrong else tuple(measured_delays(rows))
    return SignalChecks((*found, *ratio, *signs, *scale, *delays), wrong, measured)


def _moving(signals: JointSignals) -> JointSignals:
    """The signals without columns that never change."""
    for name in MEASURED:
        if getattr(signals, name) is not None and extent(getattr(signals, name)) == 0.0:
            signals = with_column(signals, name, None)
    return signals


def _ratio(rows: SlowRows, gear_ratio: float) -> list[str]:
    """The slope between the positions against the gear ratio of the model; a delay between them is no slope."""
    if not {*POSITIONS} <= rows.present:
        return []
    span = float(np.ptp(rows.rows("joint_position")[rows.usable]))
    motor_span = float(np.ptp(rows.rows("motor_shaft_position")[rows.usable]))
    if span < LEAST_MOTION or motor_span < LEAST_MOTION / gear_ratio:
        return []
    relative, torsion = RATIO_TOLERANCE if "gauge_torque" in rows.present else TORSION
    tolerance = max(relative, torsion / span)
    slope, left = _slope(rows, 0.0)
    if abs(slope - 1.0) > tolerance:
        shift, _ = position_shift(rows)[0]
        slope, left = _slope(rows, shift.seconds if shift.counts(rows.period) else 0.0)
    return [] if abs(slope - 1.0) <= tolerance or left > 0.1 else _ratio_words(gear_ratio * slope, slope, gear_ratio)


def _slope(rows: SlowRows, advance: float) -> tuple[float, float]:
    """Slope of the motor angle over the joint angle read `advance` s later, both on the output side; share left."""
    columns = [rows.rows("joint_position", 0, advance), np.ones(rows.usable.size)]
    columns += [rows.rows("gauge_torque")] if "gauge_torque" in rows.present else []
    fit = regress(rows.rows("motor_shaft_position"), columns, rows.usable)
    return float(fit.coefficients[0]), fit.rest / max(1e-300, fit.spread)


def _ratio_words(found: float, slope: float, gear_ratio: float) -> list[str]:
    """What a ratio means that is not the model's."""
    for meant, text in (
        (1.0 / gear_ratio, "motor_shaft_position looks already divided by the gear ratio"),
        (DEGREE, "joint_position looks like degrees, motor_shaft_position like rad"),
        (1.0 / DEGREE, "motor_shaft_position looks like degrees, joint_position like rad"),
    ):
        if abs(slope / meant - 1.0) < 0.1:
            return [f"{text}: it turns {found:.5g} per joint_position, the model's gear ratio is {gear_ratio:g}"]
    if slope < 0.0:
        return [
            f"motor_shaft_position and joint_position have {OPPOSITE}: slope {found:.5g}, "
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


def _gravity(rows: SlowRows, gear_ratio: float) -> list[str]:
    """torque = c x (gravity of the robot description) + inertia + friction; c is 1 but for a payload or a gain error.

    Sine and cosine of the joint's own angle are left out: beside them nothing is left of a standing arm's gravity.
    """
    if not rows.links_known:
        return []
    gravity, inertia = rows.rows("gravity"), rows.rows("inertia")
    if float(np.ptp(gravity[rows.usable])) == 0.0:
        return []
    columns = [gravity, inertia, rows.rows(rows.position, 2), *rows.friction(), np.ones(gravity.size)]
    found = []
    for name in ("gauge_torque", "motor_torque"):
        if name not in rows.present:
            continue
        fit = regress(rows.rows(name), columns, rows.usable)
        c, sure = float(fit.coefficients[0]), abs(fit.t(0)) > CLEAR_GRAVITY
        weight = abs(c) * float(np.std(gravity[rows.usable])) / max(1e-300, fit.spread)
        if sure and weight > GRAVITY_SHARE and fit.rest < SCALE_REST * fit.spread:
            found += _gravity_words(name, c, gear_ratio)
    return found


def _gravity_words(name: str, c: float, gear_ratio: float) -> list[str]:
    """What a share c of the described gravity in a torque means; nothing if it may be a payload or a gain."""
    if c < 0.0:
        return [f"the sign of {name} looks flipped: it shows {c:.3g} of the gravity that the robot description says"]
    if GRAVITY_RANGE[0] <= c <= GRAVITY_RANGE[1]:
        return []
    what = "the robot description, or the unit or scale of the torque, is another one"
    if name == "motor_torque" and 0.5 <= c * gear_ratio <= 2.0:
        what = f"it looks like the torque of the motor itself, not times the gear ratio {gear_ratio:g}"
    else:
        what = next((f"factor {text}" for factor, text in FACTORS.items() if 0.6 < c / factor < 1.6), what)
    return [f"{name} shows {c:.3g} of the gravity that the robot description says: {what}"]
