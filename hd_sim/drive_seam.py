"""The seam in front of the simulated drives: newest command, second gate, command watchdog, brake.

It is the last code before the model, and it believes nothing of the controller. `plant_node` and the runner use the
same object, so a command meets the same treatment with and without ROS.

Tick k: the newest command, normally that of tick k-1, is latched for [k, k+1), then the sensors are sampled, then the
interval is integrated. A joint whose command is missing holds its last one; at the age limit of the gate every joint
stops: torque ramps to zero and the brake closes. The brake is closed at the start. The gate opens after a
run of commands that came in time; the brake opens once the commanded torque leaves the gate unlimited, that is, when it
carries the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hd_control.control import safety_gate as gate
from hd_control.core.blocks import Block
from hd_control.core.faults import Fault

if TYPE_CHECKING:
    from hd_sim.plant import Plant

FloatArray = NDArray[np.float64]
NEVER = -1
ARMING_SAMPLES = 100
"""Healthy commands in a row before the drives obey: processes that have just started are slow at first."""


class DriveSeam:
    """A plant behind its own safety gate. `limits` is the gate's limit block for all joints of the plant."""

    def __init__(self, plant: Plant, limits: Block) -> None:
        self.plant = plant
        self.limits = limits
        self.gate = gate.initial_gate_state(limits.joints)
        self.measured = gate.new_measured(limits.joints)
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
        return bool(self.gate.stopped != 0.0)

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
        torque, self.gate, faults = gate.safety_gate_compiled(
            self.command, self.measured, ages, self._ticks, self.limits, self.gate
        )
        if self.brake_closed or faults:
            self._move_brake(torque)
        self.plant.latch(torque)
        return torque, faults if self._open else []

    def _arm(self, tick: int) -> None:
        """Opens the gate after `ARMING_SAMPLES` ticks in a row with a command that was at most one sample late."""
        self.healthy = self.healthy + 1 if self._oldest > NEVER and self._oldest >= tick - 2 else 0
        if self.healthy >= ARMING_SAMPLES:
            self.gate = gate.activate(self.gate, self.limits, np.zeros(self.limits.joints))
            self._open = True

    def sample(self) -> Block:
        """The sensors now, after `latch`: the plant's sample block."""
        return self.plant.sample()

    def advance(self) -> None:
        """Integrates one tick with the latched torque."""
        self.plant.advance()

    def reset(self, joint_velocity: FloatArray) -> list[str]:
        """Ends a latched stop if the inputs run and the joints rest; returns the reasons of a refusal."""
        self.measured.joint_velocity = joint_velocity
        self.gate, reasons = gate.reset(self.gate, self.measured, self.limits)
        return reasons

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
