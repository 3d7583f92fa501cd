"""Presliding: after a reversal friction builds up over a small travel instead of at once.

    torque on the rotor = k (H(phi) - sgn phi'),    dH = a |dphi| (sgn dphi - H)        k N m, 1/a travel, rad

This is the bristle law without its damping. Visible in the first millirad after reversals only; with k equal to the
Coulomb torque, H takes the place of the sign. Source: docs/equations/friction.md (F4), (F12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import (
    MOTOR,
    Columns,
    Confusion,
    DriveStates,
    Effect,
    EffectParameter,
    NearReversals,
    Reference,
    Shape,
)
from hd_control.drive.shapes import approach, approach_step

GRID = tuple(np.geomspace(2e-5, 3e-3, 26).tolist())
"""rad: distances that a diagnosis tries."""


@final
class Presliding(Effect):
    """Friction is missing right after a reversal and returns with travel."""

    name = "presliding"
    title = "presliding"
    evidence = "appears only in the first millirad of travel after each reversal"
    parameters = (
        EffectParameter("presliding_distance", "rad", "travel over which friction builds up", low=0.0, linear=False),
        EffectParameter("presliding_torque", "N m", "friction that builds up"),
    )
    confusions = (Confusion("stribeck_friction", "reversals of 0.1 to 3 mrad amplitude at less than 10 mrad/s"),)
    near_reversals = NearReversals("presliding_distance", GRID, "presliding_torque", over_coulomb=(0.4, 2.5), share=0.6)
    law_error = 0.4
    """The bristles of the worlds are damped, this law is not."""
    references = (
        Reference(  # one relaxation length of travel
            {"presliding_distance": 1e-3},
            {"motor_position": [0.0, 1e-3], "motor_direction": 1.0},
            {MOTOR: [[-1.0], [-math.exp(-1.0)]]},
        ),
    )
    examples = ({"presliding_distance": 2e-4, "presliding_torque": 24.0},)

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("presliding_torque",)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"presliding_distance": 1e-3 * d} for d in (0.05, 0.1, 0.2, 0.4, 0.8, 1.5))

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        return {"presliding_distance": (GRID[0], GRID[-1])}

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        distance = float(shape["presliding_distance"])
        level = approach(states.motor_position, 1.0 / distance, 0.1 * distance)
        return {MOTOR: (level - states.motor_direction)[:, None]}

    @classmethod
    def memory(cls, shape: Shape, runs: int) -> FloatArray:
        return np.full((2, runs), np.nan)

    @classmethod
    def memory_along(cls, states: DriveStates, shape: Shape, rows: IntArray) -> FloatArray:
        distance = float(shape["presliding_distance"])
        level = approach(states.motor_position, 1.0 / distance, 0.1 * distance)
        return np.stack([level[rows], states.motor_position[rows]])

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        change = np.where(np.isnan(memory[1]), 0.0, states.motor_position - memory[1])
        level = approach_step(np.nan_to_num(memory[0]), change, 1.0 / float(shape["presliding_distance"]))
        return {MOTOR: (level - states.motor_direction)[:, None]}, np.stack([level, states.motor_position])
