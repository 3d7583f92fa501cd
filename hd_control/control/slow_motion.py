"""Slow motion: a degraded robot follows its path at a quarter of the speed, and catches nothing up afterwards.

The path runs on a time of its own: `path tick = tick - lag`. The rate of that time falls from 1 to `SLOW_RATE` within
`CHANGE_TIME` and rises again in the same way, so the reference has no step in position or velocity:

    q(path tick),   q' = rate v,   q'' = rate^2 a + rate' v

A goal keeps the velocity limits, so a degraded reference keeps a quarter of them. No clock; pure numbers.
"""

from __future__ import annotations

from hd_control.core.arrays import FloatArray

SLOW_RATE = 0.25
"""Share of the velocity limits that a degraded robot may use."""
CHANGE_TIME = 0.2
"""s between full rate and `SLOW_RATE`."""


class SlowMotion:
    """Rate of the path's time and how many ticks it lags behind. `period` s is the length of a tick."""

    def __init__(self, period: float) -> None:
        self.period = period
        self._step = (1.0 - SLOW_RATE) * period / CHANGE_TIME
        self.slope = 0.0
        self.reset()

    def reset(self) -> None:
        """Full rate, no lag."""
        self.rate, self.lag = 1.0, 0.0

    @property
    def at_rest(self) -> bool:
        """True while the path's time is the time."""
        return self.rate == 1.0 and self.lag == 0.0

    def step(self, slow: bool) -> None:
        """One tick towards the wanted rate."""
        before = self.rate
        self.rate = max(SLOW_RATE, before - self._step) if slow else min(1.0, before + self._step)
        self.slope = (self.rate - before) / self.period
        self.lag += 1.0 - 0.5 * (self.rate + before)

    def scale(self, motion: FloatArray) -> None:
        """Velocity and acceleration of the path (3n,) become those of the reference, in place."""
        n = motion.size // 3
        velocity, acceleration = motion[n : 2 * n], motion[2 * n :]
        acceleration *= self.rate**2
        acceleration += self.slope * velocity
        velocity *= self.rate
