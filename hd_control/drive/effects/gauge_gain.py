"""Gain error of the torque gauge.

    tau_s = (1 + g) tau,    tau = (1 - gamma) tau_s,    gamma = g / (1 + g)        g -, tau N m

Source: docs/equations/gauge.md (S6), (S9), H(8). In the transmission it hides in the stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.drive.effect import (
    GAUGE,
    LINK,
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
class GaugeGain(Effect):
    """The bridge indicates a fixed multiple of the torque."""

    name = "gauge_gain"
    title = "gain error of the torque gauge"
    evidence = "grows with the indicated torque and stands in the rotor and the link balance with opposite signs"
    reads = GAUGE
    parameters = (
        EffectParameter(
            "gauge_gain_error", "-", "indicated over true torque, minus one", low=-0.9, high=10.0, linear=False
        ),
    )
    confusions = (
        Confusion(
            "torque_constant_error", "a known mass at two poses: known gravity fixes the gauge in the link channel"
        ),
        Confusion("payload", "use the rotor balance as well, or record with another known mass"),
    )
    references = (Reference({}, {"gauge_torque": 7.0}, {MOTOR: [[-7.0]], LINK: [[7.0]]}),)
    examples = ({"gauge_gain_error": 0.021},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("indicated_share",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        indicated = states.gauge_torque[:, None]
        return {MOTOR: -indicated, LINK: indicated}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        gain = values["gauge_gain_error"]
        return {}, np.array([gain / (1.0 + gain)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        share = float(coefficients[0])
        return {"gauge_gain_error": share / (1.0 - share)}
