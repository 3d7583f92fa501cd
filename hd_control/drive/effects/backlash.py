"""Backlash: a gap that the gear crosses without torque.

    delta = tau / k + h sgn(tau)        h half gap, rad; smoothed by tanh(tau / tau_0) within the resolution of the data

Source: docs/equations/transmission.md (T13). Valid away from impacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import BoolArray
from hd_control.drive.effect import (
    TORSION_FAMILY,
    TRANSMISSION,
    Columns,
    Confusion,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)
from hd_control.drive.needs import BOTH_SIGNS, Need

CROSSING = 2.5
"""Crossing torques beyond which the gear has left the gap."""
LANDING_S = 0.015
"""s before and after, in which the gear falls through the gap and lands."""


@final
class Backlash(Effect):
    """The torsion jumps by the gap when the torque changes its sign."""

    name = "backlash"
    title = "backlash"
    evidence = "jumps with the sign of the joint torque and is flat elsewhere"
    family = TORSION_FAMILY
    parameters = (
        EffectParameter("half_gap", "rad", "half of the gap, at the joint", low=0.0),
        EffectParameter(
            "crossing_torque", "N m", "torque over which the sign change is smeared", low=0.0, linear=False
        ),
    )
    confusions = (
        Confusion(
            "nonlinear_stiffness",
            "output locked, slow torque ramps through zero, three amplitudes: a flat part at zero torque is backlash",
        ),
        Confusion(
            "torsional_hysteresis",
            "output locked, slow torque ramps through zero: a loop that grows with amplitude is hysteresis",
        ),
    )
    references = (
        Reference({"crossing_torque": 0.1}, {"joint_torque": [-3.0, 0.1]}, {TRANSMISSION: [[1.0], [-math.tanh(1.0)]]}),
    )
    examples = ({"half_gap": 4e-5, "crossing_torque": 1.5},)

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (*super().needs(), BOTH_SIGNS)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("half_gap",)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"crossing_torque": share * states.torque_scale} for share in (0.006, 0.012, 0.02, 0.03, 0.042))

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        return {"crossing_torque": (1e-3 * states.torque_scale, 0.045 * states.torque_scale)}

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        return {TRANSMISSION: -np.tanh(states.elastic_torque / float(shape["crossing_torque"]))[:, None]}

    @classmethod
    def blind(cls, states: DriveStates, shape: Shape) -> dict[str, BoolArray]:
        """Inside the gap the torque does not determine where the gear lies."""
        inside = np.abs(states.elastic_torque) < CROSSING * float(shape["crossing_torque"])
        count = np.concatenate([[0], np.cumsum(inside)])
        margin, index = round(LANDING_S / states.period), np.arange(inside.size)
        low, high = np.maximum(index - margin, 0), np.minimum(index + margin + 1, inside.size)
        return {TRANSMISSION: np.asarray(count[high] > count[low])}
