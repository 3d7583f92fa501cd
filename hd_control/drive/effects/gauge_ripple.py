"""Ripple of the torque gauge: the wave generator strains the gauges as it turns.

    tau_s = tau + sum_n c_n cos(n beta) + s_n sin(n beta)        c_n, s_n N m
    beta = theta + turn q        theta rotor angle, q joint angle, rad

turn = 0 where the flexspline is fixed to the casing, -1 or +1 where it turns with the joint (by mounting). n = 2 is
left by a misaligned second gauge pair, n = 4 is not cancelled by any pair at 90 degrees. The torsion that the ripple
would mean is that of spring and damper in parallel, 1/(k (1 + d s)), at the frequency n beta' of the moment.
Source: docs/equations/gauge.md (S4), (S11), (S12), H(9)-(13). Valid for a ripple that does not depend on load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    GAUGE,
    LINK,
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
from hd_control.drive.shapes import harmonic_names, harmonics

ORDERS = (2, 4)


@final
class GaugeRipple(Effect):
    """A periodic error of the indicated torque."""

    name = "gauge_ripple"
    title = "ripple of the torque gauge"
    evidence = "repeats with the turn of the wave generator in the rotor and the link balance with opposite signs"
    reads = GAUGE
    parameters = (
        *(
            EffectParameter(f"{part}_{n}", "N m", f"{part} of order {n} of the gauge angle", default=0.0)
            for n in ORDERS
            for part in ("cosine", "sine")
        ),
        EffectParameter(
            "joint_turn", "-", "-1, 0 or 1: how the gauge turns with the joint", -1.0, 1.0, linear=False, default=0.0
        ),
    )
    confusions = (
        Confusion(
            "motor_cogging",
            "slow run with the link channel (order below 40 Hz), or unpowered back-driving: gauge ripple stays",
        ),
        Confusion(
            "kinematic_error", "slow run at several loads: kinematic torque grows with the load, ripple does not"
        ),
    )
    references = (
        Reference(  # 2 beta = 45 degrees
            {"orders": (2,), "joint_turn": -1},
            {"motor_position": math.pi / 8.0 + 0.3, "joint_position": 0.3, "torsional_compliance": 0.01},
            {
                MOTOR: [[-math.sqrt(0.5)] * 2],
                LINK: [[math.sqrt(0.5)] * 2],
                TRANSMISSION: [[0.01 * math.sqrt(0.5)] * 2],
            },
        ),
        Reference(  # the same at the damper's corner frequency: 45 degrees behind, 3 dB lower
            {"orders": (2,), "joint_turn": -1},
            {
                "motor_position": math.pi / 8.0 + 0.3,
                "joint_position": 0.3,
                "motor_velocity": 1.5,
                "joint_velocity": 0.5,
                "torsional_compliance": 0.01,
                "damping_time": 0.5,
            },
            {
                MOTOR: [[-math.sqrt(0.5)] * 2],
                LINK: [[math.sqrt(0.5)] * 2],
                TRANSMISSION: [[0.01 * math.sqrt(0.5), 0.0]],
            },
        ),
    )
    examples = (
        {"cosine_2": 0.5, "sine_2": 0.2, "joint_turn": 0.0},
        {"cosine_2": 0.5, "sine_2": 0.2, "cosine_4": -0.1, "sine_4": 0.3, "joint_turn": -1.0},
    )

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (WHOLE_TURN,)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        forms = [((2,), 0), ((2,), -1), ((2,), 1), ((4,), 0), (ORDERS, 0), (ORDERS, -1), (ORDERS, 1)]
        turned = bool(np.isfinite(states.joint_position).any())
        return tuple({"orders": orders, "joint_turn": turn} for orders, turn in forms if turned or turn == 0)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return harmonic_names(shape["orders"])

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        turn, angle = float(shape["joint_turn"]), states.motor_shaft_position
        waves = harmonics(angle + turn * states.joint_position if turn else angle, shape["orders"])
        columns = {MOTOR: -waves, LINK: waves}
        if states.torsional_compliance > 0.0:  # the torsion that the indicated torque would mean is not there
            rate = states.gear_ratio * states.motor_velocity + turn * states.joint_velocity
            columns[TRANSMISSION] = states.torsional_compliance * _behind_damper(waves, rate, shape, states)
        return columns

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        orders = tuple(n for n in ORDERS if f"cosine_{n}" in values or f"sine_{n}" in values) or (2,)
        shape = {"orders": orders, "joint_turn": values.get("joint_turn", 0.0)}
        return shape, np.array([values.get(name, 0.0) for name in harmonic_names(orders)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        named = dict(zip(cls.coefficient_names(shape), coefficients.tolist(), strict=True))
        return named | {"joint_turn": float(shape["joint_turn"])}


def _behind_damper(waves: FloatArray, rate: FloatArray, shape: Shape, states: DriveStates) -> FloatArray:
    """The waves (n, 2 orders) after 1 / (1 + d s) at the frequency of each instant; `rate` (n,) rad/s of the angle."""
    found: FloatArray = waves.copy()
    for k, order in enumerate(shape["orders"]):
        cosine, sine = waves[:, 2 * k], waves[:, 2 * k + 1]
        slip = np.nan_to_num(states.damping_time * order * rate)
        found[:, 2 * k] = (cosine + slip * sine) / (1.0 + slip**2)
        found[:, 2 * k + 1] = (sine - slip * cosine) / (1.0 + slip**2)
    return found
