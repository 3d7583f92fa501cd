"""Noise of the sensors and of the motor torque, from the recording itself, at frequencies where nothing else is.

    var y_k = s^2 + (s_t v_k)^2        s: the sensor's own noise, s_t: jitter of its stamps, v speed
    var u   <= s_u^2                   from what the torque shows above 0.3 of the rate

The torque's fast part may be noise of its measurement or torque that acts. Which share of it the rotor does not feel is
decided where no effect of the library lives: above 25 Hz, by the power of the innovations. It is never more than the
torque shows, so that it cannot hide an effect.
Source: docs/equations/innovations.md (K7), (K8).
"""

from __future__ import annotations

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray

SPEED_BINS = 16
SLOWEST_HZ = 25.0
SEGMENT_S = 0.256
LEAST_SEGMENT = 32
LINE = 5.0
"""Power over the median of the spectrum beyond which a line counts no further."""
THIRD_DIFFERENCE = np.array([1.0, -3.0, 3.0, -1.0])


def sensor_variance(
    reading: FloatArray, velocity: FloatArray, use: BoolArray, density: float, count: float
) -> FloatArray:
    """Variance of an angle's noise at each sample, (n,): its own and what jitter of the stamps makes of the speed.

    `density`: standard deviation of its white noise over the whole recording, `count`: step of its values, 0 if none.
    """
    from scipy.optimize import nnls

    floor = max(0.25 * density**2, count**2 / 12.0, 1e-24)
    squares, speed = np.convolve(reading, THIRD_DIFFERENCE, "valid") ** 2 / 20.0, np.abs(velocity[1:-2])
    squares, speed = squares[use[1:-2]], speed[use[1:-2]]
    if squares.size < 40 * SPEED_BINS:
        return np.full(reading.size, max(floor, density**2))
    edges = np.quantile(speed, np.linspace(0.0, 1.0, SPEED_BINS + 1))
    place = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, SPEED_BINS - 1)
    filled = np.flatnonzero(np.bincount(place, minlength=SPEED_BINS) > 20)
    level = np.array([_mean_without_bursts(squares[place == b]) for b in filled])
    power = np.array([float(np.mean(speed[place == b] ** 2)) for b in filled])
    weight = 1.0 / np.maximum(level, floor)
    (own, jitter), _ = nnls(np.column_stack([weight, weight * power]), weight * level)
    return np.asarray(max(float(own), floor) + float(jitter) * velocity**2)


def _mean_without_bursts(squares: FloatArray) -> float:
    return float(np.mean(np.minimum(squares, 30.0 * np.median(squares) + 1e-300)))


def fast_power(white: FloatArray, period: float, use: BoolArray) -> float:
    """Mean power of a standardised innovation (n,) above 25 Hz over its expected one, bursts and lines left out.

    1 if there are too few samples in a row that may be used.
    """
    length = max(round(SEGMENT_S / period), LEAST_SEGMENT)
    bad = np.concatenate([[0], np.cumsum(~use)])
    start = np.arange(0, white.size - length, length // 2)
    start = start[bad[start + length] == bad[start]]
    if start.size < 4:
        return 1.0
    window = np.hanning(length)
    pieces = white[start[:, None] + np.arange(length)] * window
    power = np.median(np.abs(np.fft.rfft(pieces, axis=1)) ** 2, axis=0) / (np.log(2.0) * np.sum(window**2))
    fast = power[np.fft.rfftfreq(length, period) > min(SLOWEST_HZ, 0.25 / period)]
    return float(np.minimum(fast, LINE * np.median(fast)).mean())
