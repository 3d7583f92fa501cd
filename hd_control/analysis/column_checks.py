"""Checks of single columns of a joint: wraps, units, stuck and saturated signals, temperatures; as sentences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hd_control.analysis.signals import JointSignals
from hd_control.core.arrays import FloatArray

POSITIONS = ("motor_shaft_position", "joint_position")
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
