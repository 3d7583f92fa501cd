"""Derivative filter D in plain Python, step by step and over a whole record.

    D(x)[k] = a D(x)[k-1] + (1 - a)(x[k] - x[k-1]) / dt        first sample: x[-1] := x[0], D := 0

Zhu uses s -> 200 s / (s + 200) at 1 kHz, that is 200 (z - 1)/(z - 0.8). Rule for the pole: exactly this setting uses
the paper's a = 1 - cutoff dt = 0.8; any other uses a = exp(-cutoff dt).
"""

import math

import numpy as np


def derivative_pole(cutoff, dt):
    """Pole a for a cut-off in rad/s and a sample time in s."""
    return 0.8 if (cutoff, dt) == (200.0, 1e-3) else math.exp(-cutoff * dt)


def low_frequency_delay(pole, dt):
    """Delay of D for slow signals, s: a dt / (1 - a) of the filter and half a sample of the difference."""
    return pole * dt / (1.0 - pole) + 0.5 * dt


class Derivative:
    """One D: `step` takes the next sample, a float or an array, and gives its rate."""

    def __init__(self, pole, dt):
        self.pole, self.dt, self.last, self.rate = pole, dt, None, 0.0

    def step(self, sample):
        if self.last is not None:
            self.rate = self.pole * self.rate + (1.0 - self.pole) * ((sample - self.last) / self.dt)
        self.last = sample
        return self.rate


def differentiate(samples, pole, dt):
    """D of a whole record, shape (ticks,) or (ticks, joints); the first row is zero."""
    derivative = Derivative(pole, dt)
    return np.array([derivative.step(sample) + 0.0 * sample for sample in samples])
