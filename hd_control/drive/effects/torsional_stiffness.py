"""Linear spring and damper of the flexspline, and the assembly zero of the joint sensor.

    q = phi - tau / k + (d / k) tau' + c0        k N m/rad, d s, c0 rad; tau N m joint torque

Source: docs/equations/transmission.md (T1), (T2), Z(1), to first order in d. Valid for torsion without lost motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    DAMPING_TIME,
    STIFFNESS,
    TRANSMISSION,
    ZERO,
    BaseNumber,
    Columns,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)


@final
class TorsionalStiffness(Effect):
    """The joint lags behind the motor in proportion to torque."""

    name = "torsional_stiffness"
    title = "torsional stiffness and damping"
    evidence = "grows in proportion to the joint torque and its rate"
    parameters = (
        EffectParameter("torsional_stiffness", "N m/rad", "linear stiffness", low=0.0),
        EffectParameter("damping_time", "s", "damping / stiffness", low=0.0, default=0.0),
        EffectParameter(
            "transmission_zero", "rad", "joint angle - motor angle without torque", default=0.0, by_assembly=True
        ),
    )
    in_every_model = True
    base = (
        BaseNumber("torsional_stiffness", STIFFNESS, TRANSMISSION),
        BaseNumber("damping_time", DAMPING_TIME, TRANSMISSION),
        BaseNumber("transmission_zero", ZERO, TRANSMISSION),
    )
    references = (Reference({}, {"joint_torque": 10.0, "joint_torque_rate": 2.0}, {TRANSMISSION: [[-10.0, 2.0, 1.0]]}),)
    examples = ({"torsional_stiffness": 2.9e5, "damping_time": 1e-3, "transmission_zero": 2e-4},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("compliance", "damping_compliance", "transmission_zero")

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        tau, rate = states.joint_torque, states.joint_torque_rate
        return {TRANSMISSION: np.stack([-tau, rate, np.ones_like(tau)], axis=1)}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        compliance = 1.0 / values["torsional_stiffness"]
        damping = values.get("damping_time", 0.0) * compliance
        return {}, np.array([compliance, damping, values.get("transmission_zero", 0.0)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        compliance, damping, zero = (float(c) for c in coefficients)
        return {
            "torsional_stiffness": 1.0 / compliance,
            "damping_time": damping / compliance,
            "transmission_zero": zero,
        }
