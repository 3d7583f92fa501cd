"""Goals of usual shapes: rest-to-rest moves and sines with a quintic envelope."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hd_control.control.path import Goal
from hd_control.core.arrays import FloatArray

QUINTIC_PEAK = 1.875
"""Peak velocity of the rest-to-rest quintic over distance D in time T is 1.875 D / T."""


def quintic_move(
    joint_names: Sequence[str], start: ArrayLike, end: ArrayLike, peak_velocity: float, identifier: str = "move"
) -> Goal:
    """One rest-to-rest quintic, all joints in the same time; the farthest reaches `peak_velocity` rad/s."""
    distance = float(np.max(np.abs(np.subtract(end, start))))
    return _at_rest(joint_names, [0.0, QUINTIC_PEAK * distance / peak_velocity], [start, end], identifier)


def moves(
    joint_names: Sequence[str],
    start: ArrayLike,
    offsets: Sequence[ArrayLike],
    peak_velocity: float,
    hold_before: float = 1.0,
    hold_after: float = 0.6,
    identifier: str = "moves",
) -> Goal:
    """Rest-to-rest moves by each of `offsets` in turn, rad, `hold_before` s first and `hold_after` s after each."""
    times, points = [0.0, hold_before], [np.asarray(start, dtype=float)] * 2
    for offset in offsets:
        travel = QUINTIC_PEAK * float(np.max(np.abs(offset))) / peak_velocity
        points += [points[-1] + np.asarray(offset)] * 2
        times += [times[-1] + travel, times[-1] + travel + hold_after]
    return _at_rest(joint_names, times, points, identifier)


def enveloped_sine(
    time: ArrayLike, amplitude: float, frequency: float, ramp_periods: float = 2.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A sin(2 pi f t) under a quintic envelope from 0 to 1 over `ramp_periods`: value and two derivatives, SI."""
    t = np.asarray(time, dtype=float)
    ramp, w = ramp_periods / frequency, 2.0 * np.pi * frequency
    x = np.clip(t / ramp, 0.0, 1.0)
    e = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    e1 = 30.0 * x**2 * (1.0 - x) ** 2 / ramp
    e2 = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
    s, c = amplitude * np.sin(w * t), amplitude * np.cos(w * t)
    return e * s, e1 * s + e * w * c, e2 * s + 2.0 * e1 * w * c - e * w**2 * s


def sine_goal(
    joint_names: Sequence[str],
    center: ArrayLike,
    amplitude: ArrayLike,
    frequency: float,
    periods: int,
    ramp_periods: int = 2,
    points_per_period: int = 80,
    identifier: str = "sine",
) -> Goal:
    """Sines of `periods` periods, the first `ramp_periods` under the envelope, and as many more fading out to rest.

    `amplitude` is one value or (n,) rad. Quintics through 80 points a period differ from the sine by 2e-12 of it.
    """
    length = (periods + ramp_periods) / frequency
    times = np.linspace(0.0, length, (periods + ramp_periods) * points_per_period + 1)
    up = enveloped_sine(times, 1.0, frequency, ramp_periods)
    down = enveloped_sine(length - times, 1.0, frequency, ramp_periods)
    late = times > 0.5 * length
    shapes = [np.where(late, sign * b, a) for a, b, sign in zip(up, down, (-1.0, 1.0, -1.0), strict=True)]
    size, q0 = np.broadcast_to(amplitude, np.shape(center)), np.asarray(center, dtype=float)
    q, v, a = (np.outer(shape, size) for shape in shapes)
    return Goal(tuple(joint_names), times, q0 + q, v, a, identifier=identifier)


def _at_rest(joint_names: Sequence[str], times: Sequence[float], points: Sequence[ArrayLike], identifier: str) -> Goal:
    """Points with zero velocity and acceleration."""
    q = np.array(points, dtype=float)
    return Goal(tuple(joint_names), np.array(times), q, np.zeros_like(q), np.zeros_like(q), identifier=identifier)
