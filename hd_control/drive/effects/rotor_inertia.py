"""Inertia of rotor, wave generator and motor-side parts.

    torque on the rotor = I* phi''        I* = N^2 J_rotor, kg m^2; phi motor angle / N, rad

Source: docs/equations/joint.md (J4), Z(2). Valid for a rigid motor shaft.
"""

from __future__ import annotations

from typing import final

from hd_control.drive.effect import (
    MOTOR,
    ROTOR_INERTIA,
    BaseNumber,
    Columns,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class RotorInertia(Effect):
    """I* phi'' resists the rotor."""

    name = "rotor_inertia"
    title = "rotor inertia"
    evidence = "grows with the motor acceleration"
    parameters = (EffectParameter("rotor_inertia", "kg m^2", "rotor inertia, output side", low=0.0),)
    in_every_model = True
    base = (BaseNumber("rotor_inertia", ROTOR_INERTIA, MOTOR),)
    references = (Reference({}, {"motor_acceleration": -3.0}, {MOTOR: [[-3.0]]}),)
    examples = ({"rotor_inertia": 28.0},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("rotor_inertia",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: states.motor_acceleration[:, None]}
