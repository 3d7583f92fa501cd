"""Derivative filter D, plain Python: the readable form of hd_control/cpp/law_math.hpp.

    D(x)[k] = a D(x)[k-1] + (1 - a)(x[k] - x[k-1]) / dt        first sample: x[-1] := x[0], D := 0

Zhu uses s -> 200 s / (s + 200) at 1 kHz, that is 200 (z - 1)/(z - 0.8). Rule for the pole: exactly this setting uses
the paper's a = 1 - cutoff dt = 0.8; any other uses a = exp(-cutoff dt).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError


def derivative_pole(cutoff: float, dt: float) -> float:
    """Pole a for a cut-off in rad/s and a sample time in s. Raises ConfigError at or above half the sample rate."""
    if not 0.0 < cutoff < math.pi / dt:
        raise ConfigError(
            f"derivative_cutoff {cutoff:g} rad/s is outside (0, {math.pi / dt:g}), half the sample rate; lower it"
        )
    papers_own = abs(dt - 1e-3) < 1e-12 and abs(cutoff - 200.0) < 1e-9
    return 0.8 if papers_own else math.exp(-cutoff * dt)


def low_frequency_delay(pole: float, dt: float) -> float:
    """Delay of D for slow signals, s: a dt / (1 - a) of the filter and half a sample of the difference."""
    return pole * dt / (1.0 - pole) + 0.5 * dt


@dataclass(frozen=True)
class Derivative:
    """Memory of one D: last sample and last rate, floats or arrays of one shape."""

    last: Any
    rate: Any

    @classmethod
    def started(cls, sample: Any) -> Derivative:
        """The filter after its first sample: rate zero."""
        return cls(sample, sample * 0.0)

    def step(self, sample: Any, pole: float, dt: float) -> Derivative:
        """The filter one sample later; `.rate` is D."""
        return Derivative(sample, pole * self.rate + (1.0 - pole) * ((sample - self.last) / dt))


def differentiate(samples: FloatArray, pole: float, dt: float) -> FloatArray:
    """D of a whole record, shape (ticks,) or (ticks, joints); the first row is zero."""
    samples = np.asarray(samples, dtype=float)
    rates = np.zeros_like(samples)
    for k in range(1, len(samples)):
        rates[k] = pole * rates[k - 1] + (1.0 - pole) * ((samples[k] - samples[k - 1]) / dt)
    return rates
