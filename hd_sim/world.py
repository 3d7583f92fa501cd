"""The world as the chain sees it: topics in, topics out, tick by tick. Knows no ROS and reads no clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hd_control.chain.black_box import BlackBox, FaultBook
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.safety.guard import refusals
from hd_control.safety.limits import SafetyLimits
from hd_sim.drive_side import DriveSide
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

_READINGS = {"motor_torque": "motor_torque_applied"}
"""Fields of the plant's sample block that are not named like the quantity of the topic."""
SENSORS: Mapping[str, tuple[str, str]] = {
    topic: (array, _READINGS.get(quantity, quantity))
    for quantity, (topic, array) in topics.quantities(*topics.SENSORS).items()
}
"""Each sensor topic with its array and the field of the plant's sample block that fills it."""


def sensor_arrays(sample: Block) -> dict[str, dict[str, FloatArray]]:
    """The readings of a sample block as the arrays of each sensor topic."""
    return {topic: {array: sample.view(name)} for topic, (array, name) in SENSORS.items()}


class World:
    """A plant behind its own safety gate, with the faults of that gate and a black box of the drive side."""

    def __init__(self, config: PlantConfig, limits: SafetyLimits, seed: int) -> None:
        self.joint_names = config.robot.joint_names
        self.seam = DriveSide(Plant(config, seed), limits)
        native = self.seam.native
        self.faults = FaultBook(native.faults)
        self.black_box = BlackBox(config.period, native.ring)
        n, slices = len(self.joint_names), self.seam.readings.layout.slices
        # The compiled drive side watches command and readings, in this order.
        self.black_box.adopt(self.joint_names, {(topics.COMMAND, "effort"): slice(0, n)}, 1)
        readings = {(topic, array): slices[name] for topic, (array, name) in SENSORS.items()}
        self.black_box.adopt(self.joint_names, readings, 1 + n)
        self._resets = 0

    def measure(self, tick: int) -> Block:
        """Gives the drives their torque for this tick and reads the sensors: the plant's sample block, a view."""
        sample = self.seam.measure(tick)
        if self.seam.native.ring.stops:
            self.black_box.look()
        return sample

    def advance(self) -> None:
        """Integrates one tick."""
        self.seam.advance()

    def command(self, joints: Sequence[int] | slice, torque: FloatArray, tick: int) -> None:
        """Takes a command for some joints."""
        self.seam.offer(joints, torque, tick)

    def missing(self, tick: int) -> list[str]:
        """Joints without a command of this tick."""
        return [name for name, seen in zip(self.joint_names, self.seam.command_tick, strict=True) if seen < tick]

    @property
    def reset_asked(self) -> bool:
        """A reset waits for the next tick."""
        return bool(self.seam.native.reset_asked)

    @reset_asked.setter
    def reset_asked(self, asked: bool) -> None:
        self.seam.native.reset_asked = asked

    @property
    def reset_answer(self) -> list[str] | None:
        """The answer to a reset, once: reasons against it; None while there is none."""
        native = self.seam.native
        return None if native.resets == self._resets else refusals(native.refusals)

    @reset_answer.setter
    def reset_answer(self, answer: None) -> None:
        self._resets = self.seam.native.resets

    def report(self) -> tuple[str, dict[str, Any]]:
        """The stop in one line, or an empty text, and values for diagnostics."""
        seam = self.seam
        values: dict[str, Any] = {"late": seam.late, "stale": seam.stale, "ahead": seam.ahead}
        values |= {
            "strangers": seam.native.strangers,
            "gate_stopped": seam.stopped,
            "armed": seam.armed,
            "healthy_commands": seam.healthy,
            "gate_stop_tick": self.faults.first_stop_tick,
            "brake_closed": seam.brake_closed,
        }
        text = (self.faults.headline(self.joint_names) or "stopped; call reset") if seam.stopped else ""
        return text, values | self.faults.values(self.joint_names)
