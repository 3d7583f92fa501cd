"""What the analysis reads of a recording: one joint's aligned columns, and the joints of a recording together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hd_control.core.arrays import BoolArray, FloatArray

SIGNALS = (
    "motor_shaft_position",
    "joint_position",
    "gauge_torque",
    "motor_torque",
    "temperature",
    "reference_position",
)
"""Columns that a joint may have. The first four decide which residual channels exist."""


@dataclass(frozen=True)
class JointSignals:
    """One joint on an even time base; every column is (n,) float64, NaN where it is missing, or None if not recorded.

    `time` s from the start, `period` s; `valid` (n,) is False inside gaps. `motor_shaft_position` rad before the gear,
    `joint_position` rad, `gauge_torque` N m as the bridge indicates it, `motor_torque` N m times the gear ratio, held
    from its stamp to the next (its true value if the drive reports it, else the command), `temperature` deg C,
    `reference_position` rad.
    `sources`: column -> the topic it came from. `period_command_delay`: samples between the stamp of `motor_torque` and
    the moment it acts that the reader has not taken out, as far as the recording tells. `notes`: what was repaired or
    looks wrong, one sentence each.
    """

    joint: str
    time: FloatArray
    period: float
    valid: BoolArray
    motor_shaft_position: FloatArray | None = None
    joint_position: FloatArray | None = None
    gauge_torque: FloatArray | None = None
    motor_torque: FloatArray | None = None
    temperature: FloatArray | None = None
    reference_position: FloatArray | None = None
    sources: Mapping[str, str] | None = None
    period_command_delay: int = 0
    notes: tuple[str, ...] = ()

    @property
    def present(self) -> tuple[str, ...]:
        """Names of the columns that are there."""
        return tuple(name for name in SIGNALS if getattr(self, name) is not None)


@dataclass(frozen=True)
class Recording:
    """The joints of a bag, all on one time base.

    `start_ns`: stamp of the first tick. `robot`: URDF text if the bag carries one. `sha256` of the bag's files.
    `problems`: what could not be read (then a command ends with exit code 3). `notes`: what holds for all joints.
    """

    path: str
    sha256: str
    joints: Mapping[str, JointSignals]
    robot: str | None = None
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    start_ns: int = 0
