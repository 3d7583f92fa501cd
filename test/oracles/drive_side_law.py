"""The seam in front of the simulated drives: newest command, second gate, command watchdog, brake.

It is the last code before the model, and it believes nothing of the controller. `plant_node` and the runner use the
same object, so a command meets the same treatment with and without ROS.

Tick k: the newest command, normally that of tick k-1, is latched for [k, k+1), then the sensors are sampled, then the
interval is integrated. A joint whose command is missing holds its last one; at the age limit every joint stops: the
guard of the drive side holds and damps with the motor's own encoder while the brakes close, then torque ramps to zero.
A controller that has let go (torque exactly zero while the joint moves) gets the brakes, too. The brake is closed at
the start. The gate opens after a run of commands that came in time; the brake opens once the commanded torque leaves
the gate unlimited, that is, when it carries the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.safety.guard import Guard
from hd_control.safety.limits import SafetyLimits

if TYPE_CHECKING:
    from hd_sim.plant import Plant

NEVER = -1
ARMING_SAMPLES = 100
"""Healthy commands in a row before the drives obey: processes that have just started are slow at first."""
LET_GO_SAMPLES = 3
"""Commands of exactly zero in a row for a moving joint that close the brakes."""
MOVING_SPEED = 0.05
"""rad/s; above what the quantisation of a 16-bit joint sensor looks like."""
VELOCITY_WEIGHT = 0.18
"""Share of a new difference in the velocity: a low-pass of 200 rad/s at 1 kHz."""


class DriveSeam:
    """A plant behind its own guard. `limits` are those of all joints of the plant."""

    def __init__(self, plant: Plant, limits: SafetyLimits) -> None:
        self.plant = plant
        self.limits = limits
        robot, period = plant.config.robot, plant.config.period
        hold = int(limits.guard.brake_samples)
        self.guard = Guard(limits, robot.position_low, robot.position_high, robot.velocity_limit, period, hold)
        self._gear_ratio, self._rate = plant.config.drives["gear_ratio"], VELOCITY_WEIGHT / period
        self._sensed = False
        n, slices = limits.joints, plant.sample().layout.slices
        self._places = np.r_[slices["motor_shaft_position"], slices["joint_position"]]
        self.positions, self.velocities = np.zeros(2 * n), np.zeros(2 * n)
        self._targets = [
            (self.guard.measured.view(f"{side}_{what}"), values[part])
            for what, values in (("position", self.positions), ("velocity", self.velocities))
            for side, part in (("motor", slice(0, n)), ("joint", slice(n, None)))
        ]
        self._zero_run = np.zeros(limits.joints)
        self.command = np.zeros(limits.joints)
        self.command_tick = np.full(limits.joints, NEVER)
        self.brake_closed = True
        self._oldest = self._newest = NEVER
        self._open = False
        self.healthy = 0
        self._ticks, self._no_age = np.zeros(limits.joints), np.zeros(limits.joints)
        self.late = 0
        self.stale = 0
        _park(plant)

    @property
    def stopped(self) -> bool:
        """True after a latched stop."""
        return self.guard.stopped

    @property
    def armed(self) -> bool:
        """True once the drives obey."""
        return self._open

    def offer(self, joints: Sequence[int] | slice, torque: FloatArray, tick: int) -> None:
        """Takes a command for all joints (a slice) or some; one not newer than the last is dropped and counted."""
        every = isinstance(joints, slice)
        if (self._newest if every else self.command_tick[joints].max()) >= tick:
            self.stale += 1
            return
        self.command[joints] = torque
        self.command_tick[joints] = tick
        self._oldest = tick if every else int(self.command_tick.min())
        self._newest = max(self._newest, tick)

    def complete(self, tick: int) -> bool:
        """True when every joint has its command of `tick`."""
        return self._oldest >= tick

    def latch(self, tick: int) -> tuple[FloatArray, list[Fault]]:
        """Gives the drives their torque for [tick, tick+1). Returns it, (n,) N m, and the gate's faults."""
        if not self._open:
            self._arm(tick)
        if self._oldest >= tick - 1:
            ages = self._no_age
        else:
            ages = (tick - 1.0) - self.command_tick
            self.late += int(self._open)
        self._ticks.fill(tick)
        demands = self._let_go() if self._open and not self.command.all() else ()
        torque, faults = self.guard.step(self.command, ages, self._ticks, demands)
        if self.brake_closed or faults:
            self._move_brake(torque)
        self.plant.latch(torque)
        return torque, faults if self._open else []

    def _arm(self, tick: int) -> None:
        """Opens the gate after `ARMING_SAMPLES` ticks in a row with a command that was at most one sample late."""
        self.healthy = self.healthy + 1 if self._oldest > NEVER and self._oldest >= tick - 2 else 0
        if self.healthy >= ARMING_SAMPLES:
            self.guard.activate(np.zeros(self.limits.joints))
            self._open = True

    def _let_go(self) -> list[Fault]:
        """Joints that move although the controller asks for exactly no torque."""
        measured = self.guard.measured
        still = (np.abs(measured.motor_velocity) <= MOVING_SPEED) & (np.abs(measured.joint_velocity) <= MOVING_SPEED)
        self._zero_run = np.where((self.command == 0.0) & ~still, self._zero_run + 1.0, 0.0)
        return [
            Fault(FaultCode.LET_GO, int(j), float(self._zero_run[j]), LET_GO_SAMPLES, Action.CONTROLLED_STOP)
            for j in np.flatnonzero(self._zero_run >= LET_GO_SAMPLES)
        ]

    def sample(self) -> Block:
        """The sensors now, after `latch`: the plant's sample block."""
        sample = self.plant.sample()
        self._sense(sample)
        return sample

    def _sense(self, sample: Block) -> None:
        """Positions and velocities of the drive's own sensors, for the guard."""
        positions, velocities = self.positions, self.velocities
        before = positions.copy()
        positions[:] = sample.array[self._places]
        positions[: len(self._gear_ratio)] /= self._gear_ratio
        if self._sensed:
            velocities += (positions - before) * self._rate - VELOCITY_WEIGHT * velocities
        for target, values in self._targets:
            target[:] = values
        self._sensed = True

    def advance(self) -> None:
        """Integrates one tick with the latched torque."""
        self.plant.advance()

    def reset(self, joint_velocity: FloatArray) -> list[str]:
        """Ends a latched stop if the inputs run and the joints rest; returns the reasons of a refusal."""
        self.guard.measured.joint_velocity = joint_velocity
        return self.guard.reset()

    def _move_brake(self, torque: FloatArray) -> None:
        carried = self._open and np.array_equal(torque, self.command)
        wanted = self.stopped or (self.brake_closed and not carried)
        if wanted != self.brake_closed:
            self.brake_closed = wanted
            self.plant.brake(wanted)


def _park(plant: Plant) -> None:
    """The brakes closed long ago: the arm rests on them until it is carried."""
    state = plant.state
    state.brake_request = 1.0
    state.brake_age = plant.config.drives["brake_closing_time"]
    plant.restore(state)
