"""Kinematic (transmission) error of the gear: the joint angle is not exactly the motor angle over N.

    KE(theta) = sum_n a_n cos(n theta) + b_n sin(n theta)        rad at the output, theta = N phi rotor angle, rad
    q = phi + KE - torsion,    torque on the rotor: tau N dKE/dtheta (energy is kept)

Dominant n = 2 (two engagement zones), then 4 and 1. Valid for an error that depends neither on load nor on the joint
angle. Source: docs/equations/transmission.md (T10), (T12), G(2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    MOTOR,
    TRANSMISSION,
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
from hd_control.drive.shapes import harmonic_names, harmonic_slopes, harmonics

ORDERS = (1, 2, 3, 4)


@final
class KinematicError(Effect):
    """A periodic error of the joint angle with the rotor angle."""

    name = "kinematic_error"
    title = "kinematic error of the gear"
    evidence = "repeats with every turn of the wave generator, in both directions alike"
    parameters = tuple(
        EffectParameter(f"{part}_{n}", "rad", f"{part} of order {n} per rotor turn, at the output", default=0.0)
        for n in ORDERS
        for part in ("cosine", "sine")
    )
    confusions = (
        Confusion("motor_cogging", "several loads: kinematic torque grows with the joint torque, cogging does not"),
        Confusion("gauge_ripple", "slow run with the link channel, or unpowered back-driving: gauge ripple stays"),
    )
    law_error = 0.007
    references = (
        Reference(  # 2 theta = 45 degrees
            {"orders": (2,)},
            {"gear_ratio": 100.0, "motor_position": math.pi / 800.0, "joint_torque": 10.0},
            {TRANSMISSION: [[math.sqrt(0.5)] * 2], MOTOR: [[-2000.0 * math.sqrt(0.5), 2000.0 * math.sqrt(0.5)]]},
            1e-9,
        ),
    )
    examples = (
        {"cosine_2": 1e-5, "sine_2": -2e-5},
        {"cosine_1": 1e-6, "sine_1": 0.0, "cosine_2": 1e-5, "sine_2": -2e-5, "cosine_4": 0.0, "sine_4": 3e-6},
    )

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (WHOLE_TURN,)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return ({"orders": (2,)}, {"orders": (2, 4)}, {"orders": (1, 2, 4)}, {"orders": ORDERS})

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return harmonic_names(shape["orders"])

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        theta = states.motor_shaft_position
        slope = harmonic_slopes(theta, shape["orders"])
        load = (states.gear_ratio * states.joint_torque)[:, None]
        return {TRANSMISSION: harmonics(theta, shape["orders"]), MOTOR: load * slope}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        orders = tuple(n for n in ORDERS if f"cosine_{n}" in values or f"sine_{n}" in values)
        return {"orders": orders}, np.array([values.get(name, 0.0) for name in harmonic_names(orders)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return dict(zip(harmonic_names(shape["orders"]), coefficients.tolist(), strict=True))
