"""Cogging of the motor: its torque depends on the rotor angle.

    torque that drives the rotor = A sin(n theta + psi)        A N m at the output, theta rotor angle, rad, psi rad

n is a whole number of slots or pole pairs per turn. Valid for an amplitude that does not depend on load.
Source: docs/equations/actuator.md (A6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
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
from hd_control.drive.needs import WHOLE_TURN, Need
from hd_control.drive.shapes import harmonics

ORDERS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 15, 16, 18, 20, 21, 24, 28, 30, 36)
"""Common pole pairs and slots per rotor turn."""


@final
class MotorCogging(Effect):
    """A torque wave over the rotor angle."""

    name = "motor_cogging"
    title = "cogging of the motor"
    evidence = "repeats with the rotor angle in the rotor balance alone, independent of load and direction"
    parameters = (
        EffectParameter("cogging_order", "1/turn", "waves per rotor turn", low=1.0, high=500.0, linear=False),
        EffectParameter("cogging_amplitude", "N m", "amplitude, output side", low=0.0, linear=False),
        EffectParameter("cogging_phase", "rad", "phase of the sine at rotor angle 0", linear=False, default=0.0),
    )
    confusions = (
        Confusion("gauge_ripple", "slow run with the link channel, or unpowered back-driving: gauge ripple stays"),
        Confusion("kinematic_error", "several loads: kinematic torque grows with the joint torque, cogging does not"),
    )
    references = (Reference({"cogging_order": 6}, {"motor_position": math.pi / 12.0}, {MOTOR: [[0.0, -1.0]]}),)
    examples = ({"cogging_order": 6.0, "cogging_amplitude": 2.0, "cogging_phase": 0.7},)

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (WHOLE_TURN,)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"cogging_order": order} for order in ORDERS)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("cosine", "sine")

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {MOTOR: -harmonics(shape["cogging_order"] * states.motor_shaft_position, (1,))}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        amplitude, phase = values["cogging_amplitude"], values.get("cogging_phase", 0.0)
        wave = np.array([amplitude * np.sin(phase), amplitude * np.cos(phase)])
        return {"cogging_order": values["cogging_order"]}, wave

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        cosine, sine = (float(c) for c in coefficients)
        return {
            "cogging_order": float(shape["cogging_order"]),
            "cogging_amplitude": float(np.hypot(cosine, sine)),
            "cogging_phase": float(np.arctan2(cosine, sine)),
        }
