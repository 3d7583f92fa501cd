"""Goals again, slow and obvious: Hermite polynomials from linear systems, the blend by time, dense samples.

Shares no code with the package and knows nothing of the checker.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial


@lru_cache
def _conditions(k):
    """Row per condition, column per power: value and derivatives below k at 0, then at 1."""
    unit = np.eye(2 * k)
    return np.array(
        [
            [polynomial.polyval(t, polynomial.polyder(unit[i], d)) for i in range(2 * k)]
            for t in (0.0, 1.0)
            for d in range(k)
        ]
    )


def _function(coefficients):
    return lambda t: polynomial.polyval(t, coefficients)


def hermite(T, left, right):
    """The polynomial on [0, T] whose value (and derivatives, as many as are given) at both ends are as given.

    Returned as three functions: itself and its first two derivatives.
    """
    k = len(left)
    values = np.array([[x * T**d for d, x in enumerate(ends)] for ends in (left, right)]).ravel()
    c = np.linalg.solve(_conditions(k), values) / T ** np.arange(2 * k)
    return [_function(polynomial.polyder(c, d)) for d in range(3)]


class DenseGoal:
    """One joint's reference: points (value tuples of 1, 2 or 3 derivatives), present state (q, v, a) at time 0."""

    def __init__(self, times, points, present, blend_time):
        self.times, self.points = list(times), [tuple(p) for p in points]
        self.parts = [
            hermite(b - a, self.points[i], self.points[i + 1])
            for i, (a, b) in enumerate(zip(self.times[:-1], self.times[1:], strict=True))
        ]
        self.fade = None
        if self.times[0] > 0:
            self._lead_in(present)
        else:
            gap = [present[d] - self.parts[0][d](0.0) for d in range(3)]
            if any(gap):
                self.fade_end = min(blend_time, self.times[-1])
                self.fade = hermite(self.fade_end, gap, (0.0, 0.0, 0.0))

    def _lead_in(self, present):
        first = list(self.points[0])
        while len(first) < 3:
            first.append(self.parts[0][len(first)](0.0) if self.parts else 0.0)
        self.parts = [hermite(self.times[0], present, first), *self.parts]
        self.times = [0.0, *self.times]
        self.points = [tuple(present[: len(self.points[0])]), *self.points]

    def __call__(self, t):
        """(q, v, a) at time t; the end is held."""
        if t >= self.times[-1]:
            return self.points[-1][0], 0.0, 0.0
        i = int(np.searchsorted(self.times, t, side="right")) - 1
        found = np.array([self.parts[i][d](t - self.times[i]) for d in range(3)])
        if self.fade is not None and t < self.fade_end:
            found += [self.fade[d](t) for d in range(3)]
        return tuple(found)

    def extremes(self, period, samples=160):
        """Lowest and highest position, largest |velocity| and |acceleration|; velocity steps count over one period."""
        low, high, speed, acceleration = np.inf, -np.inf, 0.0, 0.0
        last_velocity = None
        for i, part in enumerate(self.parts):
            T = self.times[i + 1] - self.times[i]
            t = np.linspace(0.0, T, samples)
            q, v, a = (part[d](t) for d in range(3))
            if self.fade is not None:
                fading = np.linspace(0.0, np.clip(self.fade_end - self.times[i], 0.0, T), samples)
                t = np.sort(np.append(t, fading))
                late = t + self.times[i] >= self.fade_end
                q, v, a = (part[d](t) + np.where(late, 0.0, self.fade[d](t + self.times[i])) for d in range(3))
            low, high = min(low, q.min()), max(high, q.max())
            speed, acceleration = max(speed, np.abs(v).max()), max(acceleration, np.abs(a).max())
            if last_velocity is not None:
                acceleration = max(acceleration, self._step(v[0] - last_velocity, period))
            last_velocity = v[-1]
        if len(self.points[-1]) == 1:
            acceleration = max(acceleration, self._step(last_velocity, period))
        return low, high, speed, acceleration

    @staticmethod
    def _step(change, period):
        return abs(change) / period if abs(change) > 1e-9 else 0.0
