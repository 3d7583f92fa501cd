"""What is left after the fit: bursts in time and whiteness of the whitened residual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hd_control.analysis.counts import count_tone, quantum
from hd_control.analysis.fit import Fit
from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import MOTOR

BURST_BLOCK_S = 0.33
BURST_Z = 9.0
BURSTS_LEAST = 2


@dataclass(frozen=True)
class Bursts:
    """Where in time a channel's residual is far above its noise: z of the worst block and the times, s."""

    channel: str
    worst: float
    times: tuple[float, ...]

    @property
    def found(self) -> bool:
        """True if enough blocks stick out."""
        return len(self.times) >= BURSTS_LEAST


def bursts(fit: Fit) -> list[Bursts]:
    """Chi-square per block of 0.33 s, Wilson-Hilferty, robust centre and scale, by channel."""
    found = []
    for name, residual in fit.residuals().items():
        part = fit.dictionary.rows[name]
        smooth = ~_staircase(fit, name)
        residual = residual[smooth]
        block = np.floor(part.time[smooth] / BURST_BLOCK_S).astype(np.int64)
        _, inverse, counts = np.unique(block, return_inverse=True, return_counts=True)
        mean = np.bincount(inverse, residual**2) / counts
        enough = counts >= 8
        if enough.sum() < 8:
            continue
        spread = np.sqrt(2.0 / (9.0 * counts))
        z = (np.cbrt(mean) - (1.0 - spread**2)) / spread
        centre = float(np.median(z[enough]))
        scale = max(1.0, 1.4826 * float(np.median(np.abs(z[enough] - centre))))
        z = np.where(enough, (z - centre) / scale, 0.0)
        start = np.bincount(inverse, part.time[smooth]) / counts
        found.append(Bursts(name, float(z.max()), tuple(start[z > BURST_Z].tolist())))
    return found


def _staircase(fit: Fit, name: str) -> BoolArray:
    """Rows (rows,) at which the counts of an angle are a tone in the channel's band."""
    equations, part = fit.dictionary.equations, fit.dictionary.rows[name]
    states, zero = equations.states, part.channel.band.zero
    index = np.flatnonzero(part.usable) * part.channel.band.step
    slow = count_tone(states.motor_velocity[index], quantum(states.motor_position), states.period, zero)
    if name != MOTOR:
        joint = equations.derived.filled["joint_position"]
        slow |= count_tone(states.joint_velocity[index], quantum(joint), states.period, zero)
    return slow


@dataclass(frozen=True)
class Whiteness:
    """Mean square of the whitened residual (1 = noise) and its largest autocorrelation at lags 1 to 40, in units of
    its standard error."""

    mean_square: float
    correlation: float


def whiteness(residuals: Mapping[str, FloatArray]) -> dict[str, Whiteness]:
    """Whiteness by channel."""
    found = {}
    for name, r in residuals.items():
        if r.size < 200:
            continue
        centred = r - r.mean()
        power = float(centred @ centred)
        lags = [float(centred[lag:] @ centred[:-lag]) / power * np.sqrt(r.size) for lag in range(1, 41)]
        found[name] = Whiteness(float(np.mean(r**2)), float(np.max(np.abs(lags))))
    return found
