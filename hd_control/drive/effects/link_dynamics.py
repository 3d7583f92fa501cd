"""Nominal rigid-body dynamics of the link: inertia and gravity.

    tau = s M(q) q'' + b(q, q')        M, b from the robot description; s scale of the inertia
    tau = J q'' + g_c cos q + g_s sin q        a single joint without a description; J kg m^2, g N m

Source: docs/equations/link.md (L1), (L2). Valid for rigid links.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    LINK,
    LINK_INERTIA,
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
class LinkDynamics(Effect):
    """M q'' + b resists the link; the numbers of a single joint are read by `drive.link`."""

    name = "link_dynamics"
    title = "link inertia and gravity"
    evidence = "follows the rigid-body torque"
    parameters = (
        EffectParameter("inertia_scale", "-", "true over nominal link inertia", low=0.0, default=1.0),
        EffectParameter("inertia", "kg m^2", "inertia of a single joint's link", low=0.0, linear=False, default=0.0),
        EffectParameter(
            "gravity_cosine", "N m", "gravity torque of a single joint at q = 0", linear=False, default=0.0
        ),
        EffectParameter(
            "gravity_sine", "N m", "gravity torque of a single joint at q = 90 degrees", linear=False, default=0.0
        ),
    )
    in_every_model = True
    base = (BaseNumber("inertia_scale", LINK_INERTIA, LINK, factor=True, sure_as="inertia"),)
    references = (Reference({}, {"link_inertia_torque": 4.0, "link_bias_torque": -5.0}, {LINK: [[4.0, -5.0]]}),)
    examples = (
        {"inertia_scale": 1.1},
        {"inertia_scale": 1.0, "inertia": 40.0, "gravity_cosine": 3.0, "gravity_sine": -120.0},
    )

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("inertia_scale", "bias_scale")

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {LINK: np.stack([states.link_inertia_torque, states.link_bias_torque], axis=1)}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        shape = {name: value for name, value in values.items() if name != "inertia_scale"}
        return shape, np.array([values.get("inertia_scale", 1.0), 1.0])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return {"inertia_scale": float(coefficients[0])} | {name: float(value) for name, value in shape.items()}
