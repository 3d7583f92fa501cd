"""Is a whole run safe? Conditions a to g of the safety rules, tick by tick, apart from the guard that is judged.

Reads the torque that reached the plant, the true motion, and which commands were handed over; knows limits as numbers.
"""

import numpy as np
from oracles.unsafe_torque import judge

SPEED_MARGIN = 0.05
# A spun-up rotor hands its momentum to the link through the elastic gear: the link may get up to twice its velocity.
ROTOR_SHARE = 2.0
FORCE_SHARE = 0.25


class RunOracle:
    """`look` once per tick, after it; `found` lists (tick, letter, joint)."""

    def __init__(self, limit, step, low, high, deceleration, age_limit):
        self.limit, self.step = list(limit), list(step)
        self.low, self.high, self.deceleration = np.asarray(low), np.asarray(high), np.asarray(deceleration)
        self.age_limit = age_limit
        self.before = [0.0] * len(self.limit)
        self.outside = np.zeros(len(self.limit), dtype=int)
        self.speed_at_stop = None
        self.found, self.fastest = [], 0.0

    def look(self, tick, torque, armed, stopped, controlled, last_command_tick, position, velocity, rotor, gravity):
        """One tick: what the drives got, the state of the drive side, the newest command used, the true motion.

        `gravity` gives the torque that holds the arm at a position.
        """
        letters = judge(torque.tolist(), self.before, self.limit, self.step, "ACTIVE" if armed else "INACTIVE")
        self.found += [(tick, letter, joint) for letter, joint in letters]
        if armed and not stopped and tick - 1 - last_command_tick >= self.age_limit:
            self.found.append((tick, "f", -1))
        self._envelope(tick, torque, position, velocity, gravity)
        self._motion(tick, stopped, controlled, velocity, rotor)
        self.before = torque.tolist()
        self.fastest = max(self.fastest, float(np.abs(velocity).max()))

    def _envelope(self, tick, torque, position, velocity, gravity):
        end = position + velocity * np.abs(velocity) / (2.0 * self.deceleration)
        if ((end <= self.high) & (end >= self.low)).all():
            self.outside[:] = 0
            return
        side = np.where(end > self.high, 1.0, np.where(end < self.low, -1.0, 0.0))
        self.outside = np.where(side != 0.0, self.outside + 1, 0)
        outward = torque * side > np.abs(gravity(position)) + FORCE_SHARE * np.asarray(self.limit)
        falling = np.abs(torque) < np.abs(np.asarray(self.before))
        self.found += [(tick, "e", int(j)) for j in np.flatnonzero(outward & ~falling & (self.outside > 10))]

    def _motion(self, tick, stopped, controlled, velocity, rotor):
        """Condition d for a controlled stop: no joint becomes faster than it was when the stop began."""
        if not stopped:
            self.speed_at_stop = None
            return
        if self.speed_at_stop is None:
            # Joints of an arm hand momentum to each other, so the fastest one at the stop is the measure for all.
            self.speed_at_stop = float(np.fmax(np.abs(velocity), ROTOR_SHARE * np.abs(rotor)).max())
        if controlled:
            faster = np.abs(velocity) > self.speed_at_stop + SPEED_MARGIN
            self.found += [(tick, "d", int(j)) for j in np.flatnonzero(faster)]
