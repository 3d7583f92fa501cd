"""The motor delivers more or less torque than its current and torque constant say.

    true motor torque = (1 + e) u        e -, u N m recorded motor torque, output side

Valid for an error that depends neither on current nor on temperature.
Source: docs/equations/actuator.md (A4).
"""

from __future__ import annotations

from typing import final

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


@final
class TorqueConstantError(Effect):
    """A relative error of the motor torque."""

    name = "torque_constant_error"
    title = "error of the torque constant"
    evidence = "grows in proportion to the motor torque"
    parameters = (
        EffectParameter("torque_constant_error", "-", "true over recorded motor torque, minus one", -0.9, 10.0),
    )
    confusions = (
        Confusion("gauge_gain", "a known mass at two poses: known gravity fixes the gauge in the link channel"),
        Confusion("load_dependent_friction", "both signs of speed at both signs of torque, driving and back-driving"),
    )
    references = (Reference({}, {"motor_torque": 7.0}, {MOTOR: [[-7.0]]}),)
    examples = ({"torque_constant_error": -0.02},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("torque_constant_error",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: -states.motor_torque[:, None]}
