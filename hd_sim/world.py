"""The world as the chain sees it: topics in, topics out, tick by tick. Knows no ROS and reads no clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hd_control.control.guard_limits import SafetyLimits
from hd_control.core.blocks import Block, FloatArray
from hd_control.stages.fault_book import FaultBook
from hd_sim.drive_seam import DriveSeam
from hd_sim.plant import Plant, PlantConfig

SENSORS: Mapping[str, tuple[str, str]] = {
    "encoder": ("position", "motor_shaft_position"),
    "resolver": ("position", "joint_position"),
    "gauge_bridge": ("effort", "gauge_torque"),
    "motor_torque_applied": ("effort", "motor_torque_applied"),
}


def sensor_arrays(sample: Block) -> dict[str, dict[str, FloatArray]]:
    """The readings of a sample block as the arrays of each sensor topic."""
    return {topic: {array: sample.view(name)} for topic, (array, name) in SENSORS.items()}


def sensor_places(sample: Block) -> dict[str, dict[str, range]]:
    """Where the numbers of each sensor topic lie in a sample block."""
    slices = sample.layout.slices
    return {t: {array: range(slices[name].start, slices[name].stop)} for t, (array, name) in SENSORS.items()}


class World:
    """A plant behind its own safety gate, with the faults of that gate."""

    def __init__(self, config: PlantConfig, limits: SafetyLimits, seed: int) -> None:
        self.joint_names = config.robot.joint_names
        self.seam = DriveSeam(Plant(config, seed), limits)
        self.faults = FaultBook()
        self.reset_asked = False
        self.reset_answer: list[str] | None = None

    def measure(self, tick: int) -> Block:
        """Gives the drives their torque for this tick and reads the sensors: the plant's sample block."""
        if self.reset_asked:
            self._reset()
        _, faults = self.seam.latch(tick)
        if faults:
            self.faults.note(faults, tick)
        return self.seam.sample()

    def advance(self) -> None:
        """Integrates one tick."""
        self.seam.advance()

    def command(self, joints: Sequence[int] | slice, torque: FloatArray, tick: int) -> None:
        """Takes a command for some joints."""
        self.seam.offer(joints, torque, tick)

    def missing(self, tick: int) -> list[str]:
        """Joints without a command of this tick."""
        return [name for name, seen in zip(self.joint_names, self.seam.command_tick, strict=True) if seen < tick]

    def report(self) -> tuple[str, dict[str, Any]]:
        """The stop in one line, or an empty text, and values for diagnostics."""
        seam = self.seam
        values: dict[str, Any] = {"late": seam.late, "stale": seam.stale, "gate_stopped": seam.stopped}
        values |= {
            "armed": seam.armed,
            "healthy_commands": seam.healthy,
            "gate_stop_tick": self.faults.first_stop_tick,
            "brake_closed": seam.brake_closed,
        }
        text = (self.faults.headline(self.joint_names) or "stopped; call reset") if seam.stopped else ""
        return text, values | self.faults.values(self.joint_names)

    def _reset(self) -> None:
        refused = self.seam.reset(self.seam.plant.true_joint_velocity)
        if not refused:
            self.faults.clear()
        self.reset_answer, self.reset_asked = refused, False
