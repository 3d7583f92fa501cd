"""The seam in front of the simulated drives: newest command, second gate, command watchdog, brake.

It is the last code before the model, and it believes nothing of the controller. `plant_node` and the runner use the
same object, so a command meets the same treatment with and without ROS.

Tick k: the newest command, normally that of tick k-1, is latched for [k, k+1), then the sensors are sampled, then the
interval is integrated. A joint whose command is missing holds its last one; at the age limit of the gate every joint
stops: torque ramps to zero and the brake closes. The brake is closed at the start and opens once the commanded torque
leaves the gate unlimited, that is, when it carries the arm.
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
NEVER = -1.0


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
        self.late = 0
        self.stale = 0
        _park(plant)

    @property
    def stopped(self) -> bool:
        """True after a latched stop."""
        return bool(self.gate.stopped != 0.0)

    def offer(self, joints: Sequence[int] | slice, torque: FloatArray, tick: int) -> None:
        """Takes a command for some joints, N m; one that is not newer than the last is dropped and counted."""
        if np.all(self.command_tick[joints] < tick):
            self.command[joints] = torque
            self.command_tick[joints] = tick
        else:
            self.stale += 1

    def complete(self, tick: int) -> bool:
        """True when every joint has its command of `tick`."""
        return bool(np.all(self.command_tick >= tick))

    def latch(self, tick: int) -> tuple[FloatArray, list[Fault]]:
        """Gives the drives their torque for [tick, tick+1). Returns it, (n,) N m, and the gate's faults."""
        if self.gate.active == 0.0 and np.all(self.command_tick > NEVER):
            self.gate = gate.activate(self.gate, self.limits, np.zeros(self.limits.joints))
        ages = (tick - 1.0) - self.command_tick
        self.late += int(self.gate.active != 0.0 and np.any(ages > 0.0))
        ticks = np.full(self.limits.joints, float(tick))
        torque, self.gate, faults = gate.safety_gate_compiled(
            self.command, self.measured, np.maximum(ages, 0.0), ticks, self.limits, self.gate
        )
        self._move_brake(torque)
        self.plant.latch(torque)
        return torque, faults if self.gate.active != 0.0 else []

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
        wanted = bool(self.gate.stopped != 0.0) or (
            self.brake_closed and not (self.gate.active != 0.0 and np.array_equal(torque, self.command))
        )
        if wanted != self.brake_closed:
            self.brake_closed = wanted
            self.plant.brake(wanted)


def _park(plant: Plant) -> None:
    """The brakes closed long ago: the arm rests on them until it is carried."""
    state = plant.state
    state.brake_request = 1.0
    state.brake_age = plant.config.drives["brake_closing_time"]
    plant.restore(state)
