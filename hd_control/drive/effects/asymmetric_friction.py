"""Friction that differs between the two directions.

    torque on the rotor = c + e |phi'|        c N m offset, e = (k_vp - k_vn) / 2, N m s

Source: docs/equations/friction.md (F3), (F7), Z(3), Z(4) with c, k_vp, k_vn.
"""

from __future__ import annotations

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


@final
class AsymmetricFriction(Effect):
    """An offset and a viscous part that do not change sign with the direction."""

    name = "asymmetric_friction"
    title = "direction-dependent friction"
    evidence = "keeps its sign in both directions: a constant torque, or one that grows with the speed's magnitude"
    parameters = (
        EffectParameter("friction_offset", "N m", "c: half the difference of breakaway between directions"),
        EffectParameter(
            "viscous_asymmetry", "N m s", "half the difference of viscous friction between directions", default=0.0
        ),
    )
    confusions = (
        Confusion("gauge_offset", "more than 90 degrees of joint angle, two mounting orientations, or an unloaded run"),
    )
    references = (Reference({"viscous": True}, {"motor_velocity": -2.0}, {MOTOR: [[1.0, 2.0]]}),)
    examples = (
        {"friction_offset": -2.0},
        {"friction_offset": -2.0, "viscous_asymmetry": 8.0},
    )

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return ({"viscous": False}, {"viscous": True})

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("friction_offset", "viscous_asymmetry")[: 2 if shape["viscous"] else 1]

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        both = np.stack([np.ones_like(states.motor_velocity), np.abs(states.motor_velocity)], axis=1)
        return {MOTOR: both[:, : 2 if shape["viscous"] else 1]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        viscous = values.get("viscous_asymmetry", 0.0)
        offset = values.get("friction_offset", 0.0)
        return {"viscous": viscous != 0.0}, np.array([offset, viscous] if viscous != 0.0 else [offset])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))
