"""The drives' electronics once more, in plain Python: newest command, command watchdog, guard, brake, velocities.

Works on a plant of its own (`latch`, `sample`, `advance`, `brake`, `restore`), tick by tick like the one under test.
"""

import numpy as np
from oracles.guard_law import Guard
from oracles.stages_law import FaultLog

from hd_control.core.faults import Action, Fault, FaultCode

NEVER = -1
ARMING_SAMPLES = 100
"""Healthy commands in a row before the drives obey."""
LET_GO_SAMPLES = 3
"""Commands of exactly zero in a row for a moving joint that close the brakes."""
MOVING_SPEED = 0.05
"""rad/s; above what the quantisation of a 16-bit joint sensor looks like."""
SLIP_TIME, SLIP_DISTANCE = 0.05, 1e-3
"""s after a brake opened in which no joint may move by so many rad."""
CARRY_PATIENCE = 100
"""Samples in which a command may come to carry the arm, before it is reported."""
STRANGER_SAMPLES = 1000
"""Samples after a command of another source in which the drives are not armed."""
VELOCITY_WEIGHT = 0.18
"""Share of a new difference in the velocity: a low-pass of 200 rad/s at 1 kHz."""


class DriveSide:
    """A plant behind its own guard. `limits` are those of all joints of the plant."""

    def __init__(self, plant, limits):
        robot, period, n = plant.config.robot, plant.config.period, limits.joints
        hold = int(limits.guard.brake_samples)
        self.plant, self.gear_ratio, self.rate = plant, plant.config.drives["gear_ratio"], VELOCITY_WEIGHT / period
        self.guard = Guard(limits, robot.position_low, robot.position_high, robot.velocity_limit, period, hold)
        self.positions, self.velocities, self.sensed = np.zeros(2 * n), np.zeros(2 * n), False
        self.command, self.command_tick, self.newest = np.zeros(n), np.full(n, NEVER), NEVER
        self.zero_run, self.brake_closed, self.open = np.zeros(n), True, False
        self.healthy = self.late = self.stale = self.ahead = 0
        self.now, self.lead = NEVER, 0
        self.gauge, self.waiting, self.slip_left, self.opened_at = np.zeros(n), 0, 0, np.zeros(n)
        self.slip_samples, self.stranger_left, self.strangers = round(SLIP_TIME / period), 0, 0
        self.applied, self.found, self.faults = np.zeros(n), [], FaultLog()
        state = plant.state  # the brakes closed long ago: the arm rests on them until it is carried
        state.brake_request, state.brake_age = 1.0, plant.config.drives["brake_closing_time"]
        plant.restore(state)

    def offer(self, joints, torque, tick):
        """A command for some joints, or for all (None); one that is not newer, or ahead, is dropped."""
        if tick > self.now:
            self.ahead, self.lead = self.ahead + 1, max(self.lead, tick - self.now)
            return
        chosen = np.arange(self.command.size) if joints is None else np.array(joints)
        last = self.newest if joints is None else self.command_tick[chosen].max()
        if last >= tick:
            self.stale += 1
            return
        self.command[chosen], self.command_tick[chosen] = torque, tick
        self.newest = max(self.newest, tick)

    def complete(self, tick):
        """True when every joint has its command of `tick`."""
        return bool((self.command_tick >= tick).all())

    def stranger(self):
        """Another source sends commands, too."""
        self.strangers, self.stranger_left = self.strangers + 1, STRANGER_SAMPLES

    @property
    def stands(self):
        """May another source take over?"""
        return self.guard.stopped or (not self.open and self.now - self.newest > ARMING_SAMPLES)

    def latch(self, tick):
        """Gives the drives their torque for [tick, tick + 1)."""
        demands = []
        if self.lead:
            demands.append(Fault(FaultCode.STAMP_AHEAD, -1, float(self.lead), 0.0, Action.REPORT))
        if tick < self.now:  # time went back: what was commanded belongs to another time
            self.command_tick[:], self.newest = NEVER, NEVER
        self.now, self.lead, oldest = tick, 0, self.command_tick.min()
        if not self.open:
            self.healthy = self.healthy + 1 if oldest > NEVER and oldest >= tick - 2 and not self.stranger_left else 0
            self.stranger_left = max(0, self.stranger_left - 1)
            if self.healthy >= ARMING_SAMPLES:
                self.guard.activate(np.zeros(self.command.size))
                self.open = True
        ages = np.zeros(self.command.size)
        if oldest < tick - 1:
            ages = (tick - 1.0) - self.command_tick
            self.late += int(self.open)
        demands += self._slip()
        if self.open:
            demands += self._let_go()
        self.applied, self.found = self.guard.step(self.command, ages, np.full(self.command.size, float(tick)), demands)
        self._move_brake()
        self.plant.latch(self.applied)

    def _move_brake(self):
        """Opens for a command that leaves the guard as it came and is what the gears carry; closes for a stop."""
        through = self.open and np.array_equal(self.applied, self.command)
        tolerance, beyond = self.guard.limits.guard.carry_tolerance, self.command - self.gauge
        near = np.abs(beyond) <= tolerance
        carried = self.brake_closed and through and self.sensed and near.all()
        wanted = self.guard.stopped or (self.brake_closed and not carried)
        held = self.brake_closed and wanted and through and not self.guard.stopped
        self.waiting = self.waiting + 1 if held else 0
        if self.waiting >= CARRY_PATIENCE:
            self.found += [
                Fault(FaultCode.BRAKE_HELD, j, float(beyond[j]), float(tolerance[j]), Action.REPORT)
                for j in np.flatnonzero(~near)
            ]
        if wanted != self.brake_closed:
            self.brake_closed = wanted
            self.plant.brake(wanted)
            self.slip_left, self.opened_at = (
                0 if wanted else self.slip_samples,
                self.positions[self.command.size :].copy(),
            )

    def _slip(self):
        """Joints that move as soon as their brake is open."""
        if not self.slip_left:
            return []
        self.slip_left -= 1
        moved = self.positions[self.command.size :] - self.opened_at
        return [
            Fault(FaultCode.SLIPPED, j, float(each), SLIP_DISTANCE, Action.CONTROLLED_STOP)
            for j, each in enumerate(moved)
            if not abs(each) <= SLIP_DISTANCE
        ]

    def _let_go(self):
        """Joints that move although the controller asks for exactly no torque.

        Samples in which every joint has torque neither count nor end a count.
        """
        if self.command.all():
            return []
        seen, found = self.guard.measured, []
        for j, torque in enumerate(self.command):
            moves = not (abs(seen.motor_velocity[j]) <= MOVING_SPEED and abs(seen.joint_velocity[j]) <= MOVING_SPEED)
            self.zero_run[j] = self.zero_run[j] + 1.0 if torque == 0.0 and moves else 0.0
            if self.zero_run[j] >= LET_GO_SAMPLES:
                found.append(
                    Fault(FaultCode.LET_GO, j, float(self.zero_run[j]), LET_GO_SAMPLES, Action.CONTROLLED_STOP)
                )
        return found

    def sample(self):
        """The sensors now, after `latch`; positions and velocities for the guard follow them."""
        sample, n, seen = self.plant.sample(), self.command.size, self.guard.measured
        now = np.concatenate([sample.motor_shaft_position / self.gear_ratio, sample.joint_position])
        if self.sensed:
            self.velocities = self.velocities + (
                (now - self.positions) * self.rate - VELOCITY_WEIGHT * self.velocities
            )  # fmt: skip
        self.positions, self.sensed, self.gauge = now, True, sample.gauge_torque.copy()
        seen.motor_position, seen.joint_position = now[:n], now[n:]
        seen.motor_velocity, seen.joint_velocity = self.velocities[:n], self.velocities[n:]
        return sample

    def measure(self, tick):
        """One tick up to the readings."""
        self.latch(tick)
        if self.open:
            self.faults.note(self.found, tick)
        return self.sample()

    def reset(self, joint_velocity):
        """Ends a latched stop if the inputs run and the joints rest; returns the reasons of a refusal."""
        self.guard.measured.joint_velocity = joint_velocity
        return self.guard.reset()
