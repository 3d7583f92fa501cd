"""The counts of an angle: where their error is white noise, and where it is a tone or repeats with the motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hd_control.analysis.bands import Band
from hd_control.analysis.joint_states import Derived
from hd_control.core.arrays import BoolArray, FloatArray

FEW_COUNTS, FEW_COUNTS_S = 10, 0.1
"""Counts within so many s below which the error of the counts is no noise."""
COARSE = 0.5
"""Count of an angle over that of the coarsest one of a channel below which its tones do not matter."""
MOST_NOISY = 0.6
"""Share of a channel's rows that may be left out because of the counts of an angle."""


def quantum(signal: FloatArray) -> float:
    """The count of a quantised signal; 0 if its smallest steps are no counts."""
    steps = np.abs(np.diff(signal))
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return 0.0
    small = float(np.quantile(steps, 0.01))
    whole = steps[:2000] / small
    return small if float(np.mean(np.abs(whole - np.round(whole)) < 0.05)) > 0.9 else 0.0


def count_tone(
    velocity: FloatArray, count: float, period: float, zero: float, orders: tuple[int, ...] = (1,)
) -> BoolArray:
    """Where the counts of an angle, or their beat with the sampling, fall below `zero` Hz, (n,): there the quantisation
    is a tone and no white noise. `orders`: harmonics of the count frequency that matter."""
    tone = np.zeros(velocity.size, dtype=bool)
    if count > 0.0:
        for order in orders:
            counts = order * velocity * (period / count)
            tone |= np.abs(counts - np.round(counts)) < zero * period
    return tone


def few_counts(position: FloatArray, count: float, period: float) -> BoolArray:
    """Where an angle stays within a few of its counts, (n,): there the quantisation repeats with the motion."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    if count <= 0.0:
        return np.zeros(position.size, dtype=bool)
    width = 2 * round(0.5 * FEW_COUNTS_S / period) + 1
    travel = maximum_filter1d(position, width) - minimum_filter1d(position, width)
    return np.asarray(travel < (FEW_COUNTS + 0.5) * count)


def noisy_rows(
    derived: Derived, period: float, band: Band, valid: BoolArray, angles: Mapping[str, tuple[int, ...]]
) -> BoolArray:
    """Rows of a channel, (rows,), at which the error of an angle's counts is no white noise.

    A tone of the encoder also comes back through the controller. `angles`: harmonics of the counts that matter, by the
    name of the angle; one that would take most rows is let in, and one much finer than another is no matter. `valid`
    (rows,): rows that count.
    """
    noisy = np.zeros(valid.size, dtype=bool)
    counts = {name: quantum(derived.filled[name]) for name in angles}
    for name, count in counts.items():
        if count < COARSE * max(counts.values()):
            continue
        velocity = derived.motor_velocity if name == "motor_position" else derived.joint_velocity
        rows = count_tone(velocity[:: band.step], count, period, band.zero, angles[name])
        rows |= few_counts(derived.filled[name], count, period)[:: band.step]
        if not valid.any() or (noisy | rows)[valid].mean() <= MOST_NOISY:
            noisy |= rows
    return noisy
