"""Coulomb friction of motor, bearings and teeth.

    torque on the rotor = k_c sgn(phi')        k_c N m, output side; any value in [-k_c, k_c] at rest

Source: docs/equations/friction.md (F3), (F5), Z(3) without load. Valid outside presliding.
"""

from __future__ import annotations

from typing import final

from hd_control.drive.effect import (
    COULOMB,
    MOTOR,
    BaseNumber,
    Columns,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class CoulombFriction(Effect):
    """k_c sgn(phi') resists the rotor."""

    name = "coulomb_friction"
    title = "Coulomb friction"
    evidence = "changes its sign with the direction and nothing else"
    parameters = (EffectParameter("coulomb_torque", "N m", "Coulomb friction, output side", low=0.0),)
    in_every_model = True
    base = (BaseNumber("coulomb_torque", COULOMB, MOTOR),)
    references = (Reference({}, {"motor_direction": -1.0}, {MOTOR: [[-1.0]]}),)
    examples = ({"coulomb_torque": 24.0},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("coulomb_torque",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: states.motor_direction[:, None]}
