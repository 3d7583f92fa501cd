"""Friction that changes with temperature (viscosity of the grease).

    torque on the rotor = e_v (T - T0) phi' + e_c (T - T0) sgn(phi')        e_v N m s/K, e_c N m/K, T0 degC

T0 is the mean of the first recording. Valid for a motor temperature that stands for the grease's.
Source: docs/equations/friction.md (F11).
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
from hd_control.drive.needs import Need

TEMPERATURE_SPAN = 6.0
"""K over which the temperature must move before it can be separated from time."""
WARMING = Need(
    lambda c: (
        f"temperature moves by {c.temperature_span:.1f} K only ({TEMPERATURE_SPAN:g} needed)"
        if c.temperature_span < TEMPERATURE_SPAN
        else ""
    ),
    "temperature against drift in time",
    "warm-up and cool-down by 8 K or more in one bag",
)


@final
class TemperatureFriction(Effect):
    """Viscous (and Coulomb) friction proportional to temperature."""

    name = "temperature_friction"
    title = "temperature-dependent friction"
    evidence = "follows the motor temperature, in proportion to speed or direction"
    parameters = (
        EffectParameter("viscous_slope", "N m s/K", "change of viscous friction per kelvin"),
        EffectParameter("coulomb_slope", "N m/K", "change of Coulomb friction per kelvin", default=0.0),
        EffectParameter("reference_temperature", "degC", "temperature without change", linear=False),
    )
    confusions = (
        Confusion("viscous_friction", "warm-up and cool-down in one recording, so that temperature is not time"),
        Confusion("coulomb_friction", "warm-up and cool-down in one recording, so that temperature is not time"),
    )
    references = (
        Reference(
            {"coulomb": True, "reference_temperature": 25.0},
            {"temperature": 35.0, "motor_velocity": 0.5, "motor_direction": 1.0},
            {MOTOR: [[5.0, 10.0]]},
        ),
    )
    examples = (
        {"viscous_slope": -1.5, "reference_temperature": 30.0},
        {"viscous_slope": -1.5, "coulomb_slope": 0.1, "reference_temperature": 30.0},
    )

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (WARMING,)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        known = states.temperature[np.isfinite(states.temperature)]
        mean = float(known.mean()) if known.size else 25.0
        return tuple({"coulomb": coulomb, "reference_temperature": mean} for coulomb in (False, True))

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("viscous_slope", "coulomb_slope")[: 2 if shape["coulomb"] else 1]

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        warm = states.temperature - float(shape["reference_temperature"])
        both = np.stack([warm * states.motor_velocity, warm * states.motor_direction], axis=1)
        return {MOTOR: both[:, : 2 if shape["coulomb"] else 1]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        slopes = [values.get("viscous_slope", 0.0), values.get("coulomb_slope", 0.0)]
        shape = {"coulomb": slopes[1] != 0.0, "reference_temperature": values["reference_temperature"]}
        return shape, np.array(slopes[: 2 if shape["coulomb"] else 1])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        named = dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))
        return named | {"reference_temperature": float(shape["reference_temperature"])}
