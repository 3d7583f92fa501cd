"""Which stretches of a recording are worth a closer look: chosen by the program, so that nobody has to search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray

LARGEST_S = 5.0
REVERSAL_S = 1.2
PLATEAU_S = (1.0, 5.0)
"""Shortest and longest stretch of constant speed."""
COARSE_S = 0.02
"""Steps in which constant speed is looked for."""
PLATEAU_SPREAD = 0.04
"""Relative change of speed within a stretch of constant speed."""


@dataclass(frozen=True)
class Window:
    """A part of a recording, s, and why it is shown."""

    title: str
    start: float
    end: float

    def rows(self, time: FloatArray) -> slice:
        """The rows of a channel inside the window."""
        first, last = np.searchsorted(time, [self.start, self.end])
        return slice(int(first), int(last))


def zoom_windows(
    time: FloatArray, used: BoolArray, residual: FloatArray, velocity: FloatArray, noise_floor: float
) -> tuple[Window, ...]:
    """Largest structured error, one reversal, one stretch of constant speed; what does not occur is left out.

    All (rows,) on an even time base; velocity of the motor, rad/s output side.
    """
    if time.size < 3 or not used.any():
        return ()
    step = float(time[1] - time[0])
    excess = np.where(used, residual**2 - noise_floor**2, 0.0)
    found = [largest(time, excess, step), reversal(time, used, excess, velocity, step)]
    found.append(plateau(time, used, velocity, step))
    return tuple(window for window in found if window is not None)


def largest(time: FloatArray, excess: FloatArray, step: float) -> Window:
    """The stretch with the largest squared error above the noise."""
    width = min(round(LARGEST_S / step), time.size)
    total = np.concatenate([[0.0], np.cumsum(excess)])
    start = int(np.argmax(total[width:] - total[:-width]))
    return Window("largest error above the noise", float(time[start]), float(time[start]) + width * step)


def reversal(time: FloatArray, used: BoolArray, excess: FloatArray, velocity: FloatArray, step: float) -> Window | None:
    """The change of direction with the largest squared error around it; both sides must move and count."""
    half = round(0.5 * REVERSAL_S / step)
    fast = 0.02 * float(np.quantile(np.abs(velocity), 0.98))
    crossings = np.flatnonzero(np.diff(np.sign(velocity)) != 0) + 1
    i = crossings[(crossings >= half) & (crossings < time.size - half)]
    around = np.searchsorted(crossings, i + half) - np.searchsorted(crossings, i - half + 1)
    counted, total = (np.concatenate([[0.0], np.cumsum(x)]) for x in (used, excess))
    moving = (np.abs(velocity[i - half]) > fast) & (np.abs(velocity[i + half - 1]) > fast) & (around == 1)
    i = i[moving & (counted[i + half] - counted[i - half] > 0.4 * 2 * half)]
    if not i.size:
        return None
    best = int(i[np.argmax(total[i + half] - total[i - half])])
    return Window("one reversal", float(time[best - half]), float(time[best - half]) + 2 * half * step)


def plateau(time: FloatArray, used: BoolArray, velocity: FloatArray, step: float) -> Window | None:
    """The longest stretch of constant speed, cut to the longest that is shown."""
    every = max(1, round(COARSE_S / step))
    time, used, velocity, step = time[::every], used[::every], velocity[::every], every * step
    least, most = (round(seconds / step) for seconds in PLATEAU_S)
    fast = 0.02 * float(np.quantile(np.abs(velocity), 0.98))
    best, start = slice(0, 0), 0
    low = high = float(velocity[0])
    for i, speed in enumerate(velocity):
        low, high = min(low, speed), max(high, speed)
        if not used[i] or abs(speed) < fast or high - low > PLATEAU_SPREAD * abs(high + low):
            start, low, high = i + 1, np.inf, -np.inf
        elif i + 1 - start > best.stop - best.start:
            best = slice(start, i + 1)
    if best.stop - best.start < least:
        return None
    end = min(best.stop, best.start + most)
    return Window("constant speed", float(time[best.start]), float(time[best.start]) + (end - best.start) * step)
