"""Is a whole run safe? Conditions a to g of the safety rules, tick by tick, apart from the guard that is judged.

Reads the torque that reached the plant, the true motion, and which commands were handed over; knows limits as numbers.
"""

import numpy as np
from oracles.unsafe_torque import judge

SPEED_MARGIN = 0.05
FORCE_SHARE = 0.25


def link_mobility(plant, position):
    """Acceleration of each link (n,) per torque of its own, rad/s^2 per N m: the diagonal of the inverse of M."""
    zeros = np.zeros(plant.joints)
    inertia = plant._kernel.accelerate(position, zeros, zeros, zeros)[1]
    return np.diagonal(np.linalg.inv(inertia))


class RunOracle:
    """`look` once per tick, after it; `found` lists (tick, letter, joint)."""

    def __init__(self, limit, step, low, high, deceleration, age_limit, rotor_inertia, stiffness):
        self.limit, self.step = list(limit), list(step)
        self.low, self.high, self.deceleration = np.asarray(low), np.asarray(high), np.asarray(deceleration)
        self.age_limit = age_limit
        self.rotor_inertia, self.stiffness = np.asarray(rotor_inertia), np.asarray(stiffness)
        self.before = [0.0] * len(self.limit)
        self.outside = np.zeros(len(self.limit), dtype=int)
        self.speed_at_stop = None
        self.found, self.fastest = [], 0.0

    def look(self, tick, torque, armed, stopped, controlled, last_command_tick, motion, arm):
        """One tick: what the drives got, the state of the drive side, the newest command used, the true motion.

        `motion` has joint_position, joint_velocity, motor_velocity and joint_torque; `arm` is the plant.
        """
        letters = judge(torque.tolist(), self.before, self.limit, self.step, "ACTIVE" if armed else "INACTIVE")
        self.found += [(tick, letter, joint) for letter, joint in letters]
        if armed and not stopped and tick - 1 - last_command_tick >= self.age_limit:
            self.found.append((tick, "f", -1))
        velocity = motion.joint_velocity
        self._envelope(tick, torque, motion.joint_position, velocity, arm.gravity_torque)
        self._motion(tick, stopped, controlled, motion, arm)
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

    def _motion(self, tick, stopped, controlled, motion, arm):
        """Condition d for a controlled stop: it adds no energy to the motion that it found when it began.

        Link, rotor and wound-up spring swing against each other, and what is in all three may show in the link a
        quarter of a period later. Joints of an arm hand motion to each other, so the largest is the measure for all.
        """
        if not stopped:
            self.speed_at_stop = None
            return
        if self.speed_at_stop is None:
            self.speed_at_stop = float(self._speed_in(motion, arm).max())
        if controlled:
            faster = ~(np.abs(motion.joint_velocity) <= self.speed_at_stop + SPEED_MARGIN)
            self.found += [(tick, "d", int(j)) for j in np.flatnonzero(faster)]

    def _speed_in(self, motion, arm):
        """The speed of each link, rad/s, if all the energy of its joint were in it alone."""
        wound = motion.joint_torque - arm.gravity_torque(motion.joint_position)
        elsewhere = self.rotor_inertia * motion.motor_velocity**2 + wound**2 / self.stiffness
        return np.sqrt(motion.joint_velocity**2 + elsewhere * link_mobility(arm, motion.joint_position))
