"""Hysteresis of the flexspline: the torsion depends on where the torque came from.

    h' = A delta' - alpha |delta'| h,  tau = k delta + h        A N m/rad, alpha 1/rad, saturation A/alpha N m
    q = phi - tau/k + (A / (alpha k)) H,  H = h alpha / A in [-1, 1]
    dH/d|tau| = a (s - H) / (1 + p (1 - s H))        a = alpha / k, p = A / k, s = sgn tau'

the law of Dhaouadi, written over the torque, which is measured better than the torsion; exact. Valid for a linear
elastic part and a hysteresis that does not depend on rate.
Source: docs/equations/transmission.md (T6), (T7), (T9), G(6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import (
    TORSION_FAMILY,
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
from hd_control.drive.needs import LOADED, Need
from hd_control.drive.shapes import approach, approach_step

NOISE_SHARE = 5e-4
"""Reversals of the torque below this share of its scale are noise."""
FIRST_STIFFENING = 0.2
"""p of the first guess of every shape."""


@final
class TorsionalHysteresis(Effect):
    """A rate-independent lag of the torsion behind the torque."""

    name = "torsional_hysteresis"
    title = "torsional hysteresis of the flexspline"
    evidence = (
        "lags behind the joint torque by a constant amount after each reversal of the torque, independent of speed"
    )
    family = TORSION_FAMILY
    parameters = (
        EffectParameter(
            "hysteresis_stiffness", "N m/rad", "A: added stiffness right after a reversal", low=0.0, linear=False
        ),
        EffectParameter("hysteresis_rate", "1/rad", "alpha: how fast the hysteresis saturates", low=0.0, linear=False),
    )
    confusions = (
        Confusion(
            "nonlinear_stiffness",
            "output locked, slow torque ramps through zero to +-50 % of the rated torque, three amplitudes: a loop "
            "that grows with amplitude is hysteresis",
        ),
        Confusion(
            "backlash",
            "output locked, slow torque ramps through zero: a flat part at zero torque is backlash, a loop hysteresis",
        ),
        Confusion("link_friction", "output locked, slow torque ramps: hysteresis stays, link friction goes"),
    )
    law_error = 0.14
    references = (
        Reference(  # one relaxation length up, one back
            {"torque_rate": 0.2, "stiffening": 0.0},
            {"joint_torque": [0.0, 5.0, 0.0]},
            {TRANSMISSION: [[0.0], [1.0 - math.exp(-1.0)], [-1.0 + (2.0 - math.exp(-1.0)) * math.exp(-1.0)]]},
        ),
        Reference(  # y = 1 - H from ln y + y = 1 - travel: y = 1/2 at 1/2 + ln 2
            {"torque_rate": 1.0, "stiffening": 1.0},
            {"joint_torque": [0.0, 0.5 + math.log(2.0)]},
            {TRANSMISSION: [[0.0], [0.5]]},
        ),
    )
    examples = ({"hysteresis_stiffness": 34800.0, "hysteresis_rate": 4000.0},)

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (LOADED, *super().needs())

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("torsion",)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        rates = (1.3, 2.0, 3.0, 4.5, 6.5, 9.0, 13.0, 19.0)
        return tuple({"torque_rate": a / states.torque_scale, "stiffening": FIRST_STIFFENING} for a in rates)

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        return {"torque_rate": (0.5 / states.torque_scale, 60.0 / states.torque_scale), "stiffening": (0.01, 5.0)}

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {TRANSMISSION: _level(states, shape)[:, None]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        k, stiffness, rate = context.torsional_stiffness, values["hysteresis_stiffness"], values["hysteresis_rate"]
        return {"torque_rate": rate / k, "stiffening": stiffness / k}, np.array([stiffness / rate / k])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        k = context.torsional_stiffness
        rate = float(shape["torque_rate"]) * k
        return {"hysteresis_stiffness": float(coefficients[0]) * k * rate, "hysteresis_rate": rate}

    @classmethod
    def memory(cls, shape: Shape, runs: int) -> FloatArray:
        return np.full((2, runs), np.nan)

    @classmethod
    def memory_along(cls, states: DriveStates, shape: Shape, rows: IntArray) -> FloatArray:
        return np.stack([_level(states, shape)[rows], states.elastic_torque[rows]])

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        tau = states.elastic_torque
        change = np.where(np.isnan(memory[1]), 0.0, tau - memory[1])
        rate, stiffening = float(shape["torque_rate"]), float(shape.get("stiffening", 0.0))
        level = approach_step(np.nan_to_num(memory[0]), change, rate, stiffening)
        return {TRANSMISSION: level[:, None]}, np.stack([level, tau])


def _level(states: DriveStates, shape: Shape) -> FloatArray:
    """H along a recording, (n,)."""
    rate, stiffening = float(shape["torque_rate"]), float(shape.get("stiffening", 0.0))
    return approach(states.elastic_torque, rate, NOISE_SHARE * states.torque_scale, stiffening)
