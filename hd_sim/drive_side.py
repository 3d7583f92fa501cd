"""What stands in front of the simulated drives: newest command, second gate, command watchdog, brake.

It is the last code before the model, and it believes nothing of the controller. `plant_node` and the runner use the
same object, so a command meets the same treatment with and without ROS.

Tick k: the newest command, normally that of tick k-1, is latched for [k, k+1), then the sensors are sampled, then the
interval is integrated. A joint whose command is missing holds its last one; at the age limit every joint stops: the
guard of the drive side holds and damps with the motor's own encoder while the brakes close, then torque ramps to zero.
A controller that has let go (torque exactly zero while the joint moves) gets the brakes, too. The brake is closed at
the start. The gate opens after a run of commands that came in time and from one source; the brake opens once the
commanded torque leaves the gate unlimited and is as large as what the gauges show that the gears carry. A joint that
moves in the first 50 ms after that gets the brakes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hd_control.chain.black_box import span
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.faults import Fault
from hd_control.safety.gate import faults_of
from hd_control.safety.guard import Guard, envelope, refusals
from hd_control.safety.limits import SafetyLimits
from hd_sim import _drive_side

if TYPE_CHECKING:
    from hd_sim.plant import Plant

NEVER = -1
ARMING_SAMPLES = int(_drive_side.ARMING_SAMPLES)
"""Healthy commands in a row before the drives obey: processes that have just started are slow at first."""


class DriveSide:
    """A plant behind its own guard; the face of `cpp/drive_side.hpp`. `limits` are those of all joints of the plant."""

    def __init__(self, plant: Plant, limits: SafetyLimits) -> None:
        self.plant, self.limits = plant, limits
        robot, period = plant.config.robot, plant.config.period
        slices = plant.state.layout.slices
        low, high, speed = robot.position_low, robot.position_high, robot.velocity_limit
        self.native = _drive_side.DriveSide(
            plant.world(), limits.joints, plant.state.layout.size, period, limits.gate.array, limits.guard.array,
            envelope(low, high, speed), np.ascontiguousarray(plant.config.drives["gear_ratio"], dtype=float),
            slices["joint_position"].start, slices["joint_velocity"].start, *span(period),
        )  # fmt: skip
        self.guard = Guard(limits, low, high, speed, period, int(limits.guard.brake_samples), self.native.guard)
        self.command: FloatArray = self.native.command
        self.command_tick = self.native.command_tick
        self.positions: FloatArray = self.native.positions
        self.velocities: FloatArray = self.native.velocities
        self.readings = Block(plant.sample().layout, self.native.readings)
        _park(plant)

    @property
    def stopped(self) -> bool:
        """True after a latched stop."""
        return self.guard.stopped

    @property
    def armed(self) -> bool:
        """True once the drives obey."""
        return bool(self.native.open)

    @property
    def brake_closed(self) -> bool:
        """True while the brakes hold."""
        return bool(self.native.brake_closed)

    @property
    def healthy(self) -> int:
        """Healthy commands in a row before the drives are armed."""
        return int(self.native.healthy)

    @property
    def late(self) -> int:
        """Ticks for which an old command was held."""
        return int(self.native.late)

    @property
    def stale(self) -> int:
        """Commands that were not newer than the last and were dropped."""
        return int(self.native.stale)

    @property
    def ahead(self) -> int:
        """Commands of ticks that were still to come and were dropped."""
        return int(self.native.ahead)

    @property
    def stands(self) -> bool:
        """May another source of commands take over? While stopped, or before arming if the one before is silent."""
        return bool(self.native.stands)

    def stranger(self) -> None:
        """Another source sends commands, too: the drives are not armed for a second."""
        self.native.stranger()

    def offer(self, joints: Sequence[int] | slice, torque: FloatArray, tick: int) -> None:
        """Takes a command for all joints (a slice) or some; one that is not newer, or ahead, is dropped."""
        chosen = None if isinstance(joints, slice) else [int(joint) for joint in joints]
        self.native.offer(chosen, np.ascontiguousarray(torque, dtype=float), tick)

    def complete(self, tick: int) -> bool:
        """True when every joint has its command of `tick`."""
        return bool(self.native.complete(tick))

    def latch(self, tick: int) -> tuple[FloatArray, list[Fault]]:
        """Gives the drives their torque for [tick, tick+1). Returns it, (n,) N m, and the gate's faults."""
        self.native.latch(tick)
        return self.native.applied.copy(), faults_of(self.native.rows) if self.armed else []

    def sample(self) -> Block:
        """The sensors now, after `latch`: the plant's sample block."""
        self.native.sample()
        return self.readings

    def measure(self, tick: int) -> Block:
        """One tick up to the readings: a reset that was asked for, `latch`, `sample`, a row of the black box."""
        self.native.measure(tick)
        return self.readings

    def advance(self) -> None:
        """Integrates one tick with the latched torque."""
        self.native.advance()

    def reset(self, joint_velocity: FloatArray) -> list[str]:
        """Ends a latched stop if the inputs run and the joints rest; returns the reasons of a refusal."""
        return refusals(self.native.reset(np.ascontiguousarray(joint_velocity, dtype=float)))


def _park(plant: Plant) -> None:
    """The brakes closed long ago: the arm rests on them until it is carried."""
    state = plant.state
    state.brake_request = 1.0
    state.brake_age = plant.config.drives["brake_closing_time"]
    plant.restore(state)
