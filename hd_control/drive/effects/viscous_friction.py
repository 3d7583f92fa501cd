"""Viscous friction, the same in both directions.

    torque on the rotor = k_v phi'        k_v N m s, output side

Source: docs/equations/friction.md (F3), (F6), Z(4).
"""

from __future__ import annotations

from typing import final

from hd_control.drive.effect import (
    MOTOR,
    VISCOUS,
    BaseNumber,
    Columns,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class ViscousFriction(Effect):
    """k_v phi' resists the rotor."""

    name = "viscous_friction"
    title = "viscous friction"
    evidence = "grows in proportion to the motor speed"
    parameters = (EffectParameter("viscous", "N m s", "viscous friction, output side", low=0.0),)
    in_every_model = True
    base = (BaseNumber("viscous", VISCOUS, MOTOR),)
    references = (Reference({}, {"motor_velocity": 0.5}, {MOTOR: [[0.5]]}),)
    examples = ({"viscous": 300.0},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("viscous",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: states.motor_velocity[:, None]}
