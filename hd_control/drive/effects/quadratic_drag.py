"""Drag that grows with the square of the speed (churning of lubricant, windage).

    torque on the rotor = c phi' |phi'|        c N m s^2

Source: docs/equations/friction.md (F10).
"""

from __future__ import annotations

from typing import final

import numpy as np

from hd_control.drive.effect import (
    MOTOR,
    Columns,
    Confusion,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)
from hd_control.drive.needs import SPEEDS, Need


@final
class QuadraticDrag(Effect):
    """c v |v| resists the rotor."""

    name = "quadratic_drag"
    title = "quadratic drag"
    evidence = "grows with the square of the motor speed and changes its sign with the direction"
    parameters = (EffectParameter("quadratic_drag", "N m s^2", "drag over speed squared, output side"),)
    confusions = (
        Confusion("stribeck_friction", "constant-speed plateaus in both directions, log-spaced over 2.5 decades"),
    )
    references = (Reference({}, {"motor_velocity": -2.0}, {MOTOR: [[-4.0]]}),)
    examples = ({"quadratic_drag": 5.5},)

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (SPEEDS,)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("quadratic_drag",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        v = states.motor_velocity
        return {MOTOR: (v * np.abs(v))[:, None]}
