"""Part of the link's inertia hangs on a spring of its own: a structural resonance.

    link balance: M q'' + b - tau + m (X - 1)(tau - b) = 0,    X = (w^2 + 2 z w s) / (s^2 + 2 z w s + w^2)

m = mu / (1 - mu), mu the share of the inertia that hangs on the spring; w = w_0 / sqrt(1 - mu), z = z_0 / sqrt(1 - mu)
with w_0 (2 pi Hz) and z_0 of the hanging part alone, joint held. Exact for gravity of the rigid link. Discretised with
linear input between samples. Valid well below the sample rate. Source: docs/equations/link.md (L5), (L6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import (
    LINK,
    Columns,
    Confusion,
    Context,
    DriveStates,
    Effect,
    EffectParameter,
    Reference,
    Shape,
)
from hd_control.drive.shapes import held

FREQUENCIES = (9.0, 11.0, 13.0, 15.5, 18.0, 21.0, 24.0, 27.0, 31.0, 36.0)
SLOW_FREQUENCIES = (1.5, 2.5, 4.0, 5.5, 7.0)
DAMPINGS = (0.02, 0.05, 0.12)


@final
class StructuralResonance(Effect):
    """A hanging inertia that answers late and amplified near its frequency."""

    name = "structural_resonance"
    title = "structural resonance of the link"
    evidence = "appears in bursts where the motion meets one frequency"
    parameters = (
        EffectParameter("frequency", "Hz", "of the hanging part, joint held", low=0.5, high=200.0, linear=False),
        EffectParameter("damping_ratio", "-", "of the hanging part, joint held", low=1e-3, high=1.0, linear=False),
        EffectParameter("inertia_share", "-", "hanging over whole link inertia", low=0.0, high=0.95, linear=False),
    )
    confusions = (
        Confusion("payload", "chirp with at least 5 s between 8 and 40 Hz: inertia adds no peak"),
        Confusion("link_friction", "constant speeds: friction stays, a resonance is silent"),
    )
    law_error = 0.015
    references = (
        Reference(  # a constant load moves nothing
            {"frequency": 20.0, "damping_ratio": 0.05}, {"joint_torque": [5.0, 5.0, 5.0]}, {LINK: [[0.0]] * 3}, 1e-9
        ),
    )
    examples = ({"frequency": 18.0, "damping_ratio": 0.03, "inertia_share": 0.15},)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        limit = 0.25 / states.period
        return tuple({"frequency": f, "damping_ratio": z} for f in FREQUENCIES for z in DAMPINGS if f < limit) or (
            {"frequency": 0.5 * limit, "damping_ratio": DAMPINGS[0]},
        )

    @classmethod
    def more_shapes(cls, states: DriveStates) -> Sequence[Shape]:
        return tuple({"frequency": f, "damping_ratio": z} for f in SLOW_FREQUENCIES for z in DAMPINGS)

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        lowest = min(4.0, 0.5 * float(shape["frequency"]))
        return {"frequency": (lowest, min(60.0, 0.3 / states.period)), "damping_ratio": (3e-3, 0.5)}

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("hanging_over_rigid",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        from scipy.signal import lfilter

        drive = held(states.joint_torque - states.link_bias_torque)
        b, a, rest = _filter(float(shape["frequency"]), float(shape["damping_ratio"]), states.period)
        column, _ = lfilter(b, a, drive, zi=np.array(rest) * drive[0])
        return {LINK: column[:, None]}

    @classmethod
    def memory_along(cls, states: DriveStates, shape: Shape, rows: IntArray) -> FloatArray:
        drive = held(states.joint_torque - states.link_bias_torque)
        b, a, _ = _filter(float(shape["frequency"]), float(shape["damping_ratio"]), states.period)
        out = cls.columns(states, shape)[LINK][:, 0]
        first = out - b[0] * drive
        after = first[np.minimum(rows + 1, first.size - 1)]
        return np.stack([first[rows], after - b[1] * drive[rows] + a[1] * out[rows]])

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        share = values["inertia_share"]
        free = 1.0 / np.sqrt(1.0 - share)
        shape = {"frequency": values["frequency"] * free, "damping_ratio": values["damping_ratio"] * free}
        return shape, np.array([share / (1.0 - share)])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        ratio = float(coefficients[0])
        share = ratio / (1.0 + ratio)
        held_joint = float(np.sqrt(max(1.0 - share, 0.0)))
        return {
            "frequency": float(shape["frequency"]) * held_joint,
            "damping_ratio": float(shape["damping_ratio"]) * held_joint,
            "inertia_share": share,
        }

    @classmethod
    def memory(cls, shape: Shape, runs: int) -> FloatArray:
        return np.full((2, runs), np.nan)

    @classmethod
    def advance(cls, states: DriveStates, shape: Shape, memory: FloatArray) -> tuple[Columns, FloatArray]:
        drive = states.joint_torque - states.link_bias_torque
        b, a, rest = _filter(float(shape["frequency"]), float(shape["damping_ratio"]), states.period)
        z = np.where(np.isnan(memory), np.array(rest)[:, None] * drive, memory)
        out = b[0] * drive + z[0]
        new = np.stack([b[1] * drive + z[1] - a[1] * out, b[2] * drive - a[2] * out])
        return {LINK: out[:, None]}, new


@lru_cache(maxsize=256)
def _filter(
    frequency: float, damping: float, period: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """X - 1 as a difference equation b, a (3 numbers each), and its state at rest per unit of constant input."""
    from scipy.signal import cont2discrete, lfilter_zi

    w = 2.0 * np.pi * frequency
    b, a, _ = cont2discrete(([-1.0, 0.0, 0.0], [1.0, 2.0 * damping * w, w * w]), period, method="foh")
    b = np.asarray(b).ravel()
    return tuple(b.tolist()), tuple(np.asarray(a).tolist()), tuple(np.asarray(lfilter_zi(b, a)).tolist())
