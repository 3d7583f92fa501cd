"""Where each signal of a joint comes from: topic, field, unit, sign. The topics of this package, or a foreign bag's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hd_control.core.arrays import FloatArray

DEGREE = np.pi / 180.0
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "angle": {"rad": (1.0, 0.0), "mrad": (1e-3, 0.0), "deg": (DEGREE, 0.0), "turn": (2.0 * np.pi, 0.0)},
    "torque": {
        "Nm": (1.0, 0.0),
        "mNm": (1e-3, 0.0),
        "kNm": (1e3, 0.0),
        "Ncm": (1e-2, 0.0),
        "lbf ft": (1.3558179483314, 0.0),
        "lbf in": (0.1129848290276, 0.0),
        "ozf in": (0.00706155181422604, 0.0),
    },
    "temperature": {"degC": (1.0, 0.0), "K": (1.0, -273.15), "degF": (5.0 / 9.0, -160.0 / 9.0)},
    "velocity": {"rad/s": (1.0, 0.0), "deg/s": (DEGREE, 0.0), "rpm": (np.pi / 30.0, 0.0)},
}
"""Quantity -> unit -> (factor, offset) to rad, N m, deg C, rad/s: value * factor + offset."""
QUANTITIES = {
    "motor_shaft_position": "angle",
    "joint_position": "angle",
    "reference_position": "angle",
    "gauge_torque": "torque",
    "motor_torque": "torque",
    "temperature": "temperature",
    "joint_velocity": "velocity",
}
"""Signals that a mapping may name. `joint_velocity` is carried by import for the reader's eyes; no channel needs it."""


@dataclass(frozen=True)
class SignalSource:
    """One signal in a bag (`topic`, `field`) or in a table (`columns`), and how it becomes SI.

    SI value = sign * scale * (raw in `unit`) + offset, each one number or one per joint. `wrap`: the range after which
    the raw angle starts again (360 for degrees), 0 if it does not. `delay` s: the signal is late by this much.
    `held`: the value stays until the next stamp (a command); else it was measured at its stamp. `acts_later`: samples
    between stamp and effect. `columns`: names in a CSV or NPZ file, `{joint}` standing for the source's joint name.
    """

    signal: str
    topic: str = ""
    field: str = ""
    unit: str = ""
    sign: float | Mapping[str, float] = 1.0
    scale: float | Mapping[str, float] = 1.0
    offset: float | Mapping[str, float] = 0.0
    wrap: float = 0.0
    delay: float = 0.0
    held: bool = False
    acts_later: int = 0
    columns: str | Mapping[str, str] = ""

    def convert(self, joint: str, raw: FloatArray) -> FloatArray:
        """The signal in SI, (n,), NaN where it was NaN; wrapped angles become continuous."""
        values = raw
        if self.wrap > 0.0:
            finite = np.isfinite(raw)
            values = np.full(raw.shape, np.nan)
            values[finite] = np.unwrap(raw[finite], period=self.wrap)
        factor, zero = UNITS[QUANTITIES[self.signal]][self.unit] if self.unit else (1.0, 0.0)
        sign, scale, offset = (_of(number, joint, default) for number, default in self._numbers())
        if (factor, zero, sign, scale, offset) == (1.0, 0.0, 1.0, 1.0, 0.0):
            return values
        converted: FloatArray = sign * scale * (values * factor + zero) + offset
        return converted

    def _numbers(self) -> Sequence[tuple[float | Mapping[str, float], float]]:
        return (self.sign, 1.0), (self.scale, 1.0), (self.offset, 0.0)


@dataclass(frozen=True)
class TimeSource:
    """The time of a table: column, unit in s; `period` s if the samples are even and only their stamps are not."""

    column: str = ""
    unit: float = 1.0
    period: float = 0.0


@dataclass(frozen=True)
class SourceMap:
    """All sources: per signal those that may be there, the best first. `joints`: our name -> name in the source.

    No `joints` means that every joint keeps its name.
    """

    name: str
    signals: Mapping[str, Sequence[SignalSource]]
    joints: Mapping[str, str] = field(default_factory=dict)
    time: TimeSource = TimeSource()

    def ours(self, source_joint: str) -> str | None:
        """Our name of a joint of the source; None if the mapping leaves it out."""
        if not self.joints:
            return source_joint
        return next((ours for ours, theirs in self.joints.items() if theirs == source_joint), None)


def held_from_measured(column: FloatArray) -> FloatArray:
    """What, held from tick to tick, stands for a torque that was measured at the ticks: the mean over each tick."""
    mean: FloatArray = column.copy()
    mean[:-1] = 0.5 * (column[:-1] + column[1:])
    return mean


def _of(number: float | Mapping[str, float], joint: str, default: float) -> float:
    return float(number.get(joint, default) if isinstance(number, Mapping) else number)


def _standard() -> SourceMap:
    table = (
        SignalSource("motor_shaft_position", "encoder", "position"),
        SignalSource("joint_position", "resolver", "position"),
        SignalSource("joint_position", "joint_states", "position"),
        SignalSource("gauge_torque", "gauge_bridge", "effort"),
        SignalSource("gauge_torque", "joint_states", "effort"),
        SignalSource("motor_torque", "motor_torque_applied", "effort", held=True),
        SignalSource("motor_torque", "motor_torque_command", "effort", held=True, acts_later=1),
        SignalSource("temperature", "motor_temperature", "temperature"),
        SignalSource("reference_position", "joint_reference", "position"),
    )
    names = dict.fromkeys(source.signal for source in table)
    return SourceMap("standard", {name: tuple(s for s in table if s.signal == name) for name in names})


STANDARD = _standard()
"""The topics of this package (interfaces, section 3)."""
