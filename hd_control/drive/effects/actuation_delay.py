"""The recorded motor torque acts later than its stamp says.

    true motor torque(t) = u(t - D)        u N m held over a tick of the recording, D s

Its column u(t) - u(t - D) has coefficient 1 where D is right. With a held command the mean over a tick is exact for any
D; valid for a delay that does not change.
Source: docs/equations/actuator.md (A2), (A5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import (
    MOTOR,
    Columns,
    Confusion,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class ActuationDelay(Effect):
    """A pure delay of the motor torque."""

    name = "actuation_delay"
    title = "delay of the motor torque"
    evidence = "grows with the rate of the motor torque"
    parameters = (
        EffectParameter("delay", "s", "delay beyond what the recording declares", low=0.0, high=0.1, linear=False),
    )
    confusions = (
        Confusion("rotor_inertia", "chirp of the motor torque to 40 Hz or more with the joint locked"),
        Confusion("structural_resonance", "chirp of the motor torque to 40 Hz or more with the joint locked"),
    )
    shifts_command = "delay"
    law_error = 0.1
    """A delay is judged beside an undeclared one of the recording."""
    references = (
        Reference({"delay": 0.5e-3}, {"motor_torque": [0.0, 1.0, 1.0]}, {MOTOR: [[0.0], [0.5], [0.0]]}),
        Reference({"delay": 1e-3}, {"motor_torque": [0.0, 1.0, 1.0]}, {MOTOR: [[0.0], [1.0], [0.0]]}),
    )
    examples = ({"delay": 1.3e-3},)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"delay": delay} for delay in (0.5e-3, 1.5e-3, 3e-3))

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        return {"delay": (2e-5, 12e-3)}

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("share",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        u = states.motor_torque
        whole, part = _samples(float(shape["delay"]), states.period)
        padded = np.concatenate([np.full(whole + 1, u[0] if u.size else 0.0), u])
        late = (1.0 - part) * padded[1 : u.size + 1] + part * padded[: u.size]
        return {MOTOR: (u - late)[:, None]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        return {"delay": values["delay"]}, np.ones(1)

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return {"delay": float(shape["delay"]) * float(coefficients[0])}

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        whole, part = _samples(float(shape["delay"]), states.period)
        u = states.motor_torque
        past = memory if memory.shape[0] == whole + 1 else np.tile(u, (whole + 1, 1))
        line = np.concatenate([u[None], past])  # newest first
        late = (1.0 - part) * line[whole] + part * line[whole + 1]
        return {MOTOR: (u - late)[:, None]}, line[:-1]

    @classmethod
    def memory_along(cls, states: DriveStates, shape: Shape, rows: IntArray) -> FloatArray:
        whole, _ = _samples(float(shape["delay"]), states.period)
        back = np.arange(1, whole + 2)[:, None]
        return np.asarray(states.motor_torque[np.maximum(rows[None] - back, 0)])


def _samples(delay: float, period: float) -> tuple[int, float]:
    """Whole samples and the rest as a share of a sample."""
    whole = int(np.floor(delay / period + 1e-9))
    return whole, max(delay / period - whole, 0.0)
