"""Stribeck friction: Coulomb friction is higher at low speed.

    torque on the rotor = k_c (r_s - 1) exp(-(phi'/v_s)^2) sgn(phi')        r_s ratio at rest, v_s rad/s

Source: docs/equations/friction.md (F2), (F9): a factor on the Coulomb torque of Z(3). Valid outside presliding.
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
from hd_control.drive.needs import SPEEDS, Need


@final
class StribeckFriction(Effect):
    """Extra friction below the Stribeck speed."""

    name = "stribeck_friction"
    title = "Stribeck friction"
    evidence = "changes its sign with the direction and fades with speed"
    parameters = (
        EffectParameter("stribeck_ratio", "-", "friction at rest over Coulomb friction", low=0.0, linear=False),
        EffectParameter("stribeck_velocity", "rad/s", "speed at which the extra friction fades", low=0.0, linear=False),
    )
    confusions = (
        Confusion("quadratic_drag", "constant-speed plateaus in both directions, log-spaced over 2.5 decades"),
        Confusion("presliding", "reversals of 0.1 to 3 mrad at less than 10 mrad/s"),
    )
    references = (
        Reference(
            {"stribeck_velocity": 0.1},
            {"motor_velocity": -0.1, "motor_direction": -1.0},
            {MOTOR: [[-math.exp(-1.0)]]},
        ),
    )
    examples = ({"stribeck_ratio": 1.4, "stribeck_velocity": 0.05},)

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (SPEEDS,)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("rise",)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"stribeck_velocity": 1e-3 * v} for v in (22, 30, 40, 55, 75, 100, 135, 180, 240, 320))

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        return {"stribeck_velocity": (0.018, 0.4)}

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        x = states.motor_velocity / float(shape["stribeck_velocity"])
        return {MOTOR: (states.motor_direction * np.exp(-(x**2)))[:, None]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        rise = max(context.coulomb_torque, 1e-9) * (values["stribeck_ratio"] - 1.0)
        return {"stribeck_velocity": values["stribeck_velocity"]}, np.array([rise])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        ratio = 1.0 + float(coefficients[0]) / max(context.coulomb_torque, 1e-9)
        return {"stribeck_ratio": ratio, "stribeck_velocity": float(shape["stribeck_velocity"])}
