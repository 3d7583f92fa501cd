"""The joint's angle sensor sits off its axis: its reading errs once and twice per joint turn.

    reading = q + sum_n c_n cos(n q) + s_n sin(n q),  n = 1, 2        c_n, s_n rad, q joint angle, rad

Source: docs/equations/encoders.md (E4). Identical to a transmission error of the same order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    JOINT_SENSOR,
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
from hd_control.drive.needs import Need
from hd_control.drive.shapes import harmonic_names, harmonics

ORDERS = (1, 2)


JOINT_RANGE = np.pi / 4
"""rad of joint angle over which an eccentricity can be separated from stiffness."""
WIDE = Need(
    lambda c: (
        f"the joint moves over {np.degrees(c.joint_range):.0f} degrees only" if c.joint_range < JOINT_RANGE else ""
    ),
    "eccentricity against stiffness",
    "a slow move over more than 90 degrees of the joint",
)


@final
class JointSensorEccentricity(Effect):
    """A slow periodic error of the joint reading."""

    name = "joint_sensor_eccentricity"
    title = "eccentricity of the joint sensor"
    evidence = "follows the joint angle once or twice per turn, independent of load and direction"
    reads = JOINT_SENSOR
    parameters = tuple(
        EffectParameter(f"{part}_{n}", "rad", f"{part} of order {n} per joint turn", default=0.0)
        for n in ORDERS
        for part in ("cosine", "sine")
    )
    confusions = (
        Confusion("kinematic_error", "a second output sensor, or the joint sensor re-mounted turned by 90 degrees"),
        Confusion("torsional_stiffness", "the same angles with another load: compliance follows the load"),
    )
    references = (
        Reference(
            {"orders": (1, 2)},
            {"joint_position": math.pi / 6.0},
            {TRANSMISSION: [[math.sqrt(0.75), 0.5, 0.5, math.sqrt(0.75)]]},
        ),
    )
    examples = (
        {"cosine_1": 4e-5, "sine_1": 1e-5},
        {"cosine_1": 4e-5, "sine_1": 1e-5, "cosine_2": -1e-5, "sine_2": 2e-6},
    )

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (WIDE,)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return ({"orders": (1,)}, {"orders": ORDERS})

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return harmonic_names(shape["orders"])

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {TRANSMISSION: harmonics(states.joint_position, shape["orders"])}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        orders = tuple(n for n in ORDERS if f"cosine_{n}" in values or f"sine_{n}" in values) or (1,)
        return {"orders": orders}, np.array([values.get(name, 0.0) for name in harmonic_names(orders)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        return dict(zip(harmonic_names(shape["orders"]), coefficients.tolist(), strict=True))
