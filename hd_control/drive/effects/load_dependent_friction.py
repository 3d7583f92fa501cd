"""Coulomb friction that grows with the load on the teeth.

    torque on the rotor = k_c (g1 |tau| + g2 tau^2) sgn(phi')        g1 1/(N m), g2 1/(N m)^2

Source: docs/equations/friction.md (F1), (F8), Z(3). Valid outside presliding.
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
class LoadDependentFriction(Effect):
    """Friction proportional to the magnitude of the joint torque."""

    name = "load_dependent_friction"
    title = "load-dependent friction"
    evidence = "changes its sign with the direction and grows with the magnitude of the joint torque"
    parameters = (
        EffectParameter("load_friction_linear", "1/(N m)", "growth of Coulomb friction with torque"),
        EffectParameter("load_friction_quadratic", "1/(N m)^2", "growth with torque squared", default=0.0),
    )
    confusions = (
        Confusion("torque_constant_error", "both signs of speed at both signs of torque, driving and back-driving"),
        Confusion("gauge_gain", "known mass at two poses: gravity fixes the gauge in the link channel"),
    )
    references = (
        Reference({"order": 2}, {"motor_direction": -1.0, "joint_torque": -4.0}, {MOTOR: [[-4.0, -16.0]]}),
        Reference({"order": 1}, {"motor_direction": 1.0, "joint_torque": -4.0}, {MOTOR: [[4.0]]}),
    )
    examples = (
        {"load_friction_linear": 3e-3},
        {"load_friction_linear": 3e-3, "load_friction_quadratic": 4e-6},
    )

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return ({"order": 1}, {"order": 2})

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("linear", "quadratic")[: int(shape["order"])]

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        s, load = states.motor_direction, np.abs(states.joint_torque)
        return {MOTOR: np.stack([s * load, s * load**2], axis=1)[:, : int(shape["order"])]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        second = values.get("load_friction_quadratic", 0.0)
        both = max(context.coulomb_torque, 1e-9) * np.array([values.get("load_friction_linear", 0.0), second])
        return ({"order": 2}, both) if second != 0.0 else ({"order": 1}, both[:1])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        names = ("load_friction_linear", "load_friction_quadratic")
        return dict(zip(names, (coefficients / max(context.coulomb_torque, 1e-9)).tolist(), strict=False))
