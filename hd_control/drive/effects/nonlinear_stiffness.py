"""A spring that is not linear: it stiffens under load, or is soft around zero torque.

    hardening: tau = k delta + m2 delta^3        column -[delta(tau) - tau/k], delta from x = y + r y^3
    soft wind-up: delta = tau/k + depth g, g = tanh(tau / tau_0 + s g)     depth rad, tau_0 = k width, width rad

s, the steepening, is 0 for a soft zone that closes with the torque, depth / width for one that closes with the torsion
(tanh(delta / width)), negative for one that closes slowly; s < 1. Hardening: x = tau / tau_scale, y = k delta /
tau_scale, r = m2 tau_scale^2 / k^3 (negative: softening, up to its peak).
The law is inverted, for a column tau^3 misfits strong hardening.
Source: docs/equations/transmission.md (T3), (T4), (T5), G(5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from hd_control.core.arrays import FloatArray
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
from hd_control.drive.needs import BOTH_SIGNS, LOADED, Need

HARDENING, WINDUP = "hardening", "windup"
TABLE, FULL = 2000, 12.0
STEEPENINGS = (0.0, 0.7)
STEEPEST = 0.95


def _inverse(x: FloatArray, r: float) -> FloatArray:
    """y with y + r y^3 = x: Cardano's real root, the small one where softening (r < 0) has three."""
    if abs(r) < 1e-9:
        return np.asarray(x - r * x**3)
    width = 2.0 / np.sqrt(3.0 * abs(r))
    if r > 0.0:
        return np.asarray(width * np.sinh(np.arcsinh(3.0 * x / width) / 3.0))
    return np.asarray(width * np.sin(np.arcsin(np.clip(3.0 * x / width, -1.0, 1.0)) / 3.0))


def _soft(x: FloatArray, steepening: float) -> FloatArray:
    """g with g = tanh(x + s g): the table of x(y) = y - s tanh y, tanh y = g, read backwards."""
    y = np.linspace(0.0, 1.0, TABLE) ** 1.5 * FULL
    return np.asarray(np.sign(x) * np.tanh(np.interp(np.abs(x), y - steepening * np.tanh(y), y)))


@final
class NonlinearStiffness(Effect):
    """Cubic hardening or a soft zone around zero torque."""

    name = "nonlinear_stiffness"
    title = "nonlinear torsional stiffness"
    evidence = "depends on the joint torque alone, as a curve without a loop"
    family = TORSION_FAMILY
    parameters = (
        EffectParameter("stiffness_cubic", "N m/rad^3", "m2 of tau = k delta + m2 delta^3", linear=False, default=0.0),
        EffectParameter("windup_depth", "rad", "lost motion of the soft zone, on each side", linear=False, default=0.0),
        EffectParameter(
            "windup_width", "rad", "torsion over which the soft zone reaches", low=0.0, linear=False, default=0.0
        ),
        EffectParameter(
            "windup_steepening",
            "-",
            "how much the soft zone's own torsion closes it",
            low=-2.0,
            high=STEEPEST,
            linear=False,
            default=0.0,
        ),
    )
    confusions = (
        Confusion(
            "backlash",
            "output locked, slow torque ramps through zero, three amplitudes: a flat part at zero torque is backlash",
        ),
        Confusion("torsional_hysteresis", "output locked, slow torque ramps up and down: no loop is stiffness"),
    )
    references = (
        Reference(  # y + y^3 = 2 has y = 1
            {"form": HARDENING, "hardening": 1.0, "scale": 1.0},
            {"joint_torque": [2.0, -2.0]},
            {TRANSMISSION: [[1.0], [-1.0]]},
        ),
        Reference({"form": WINDUP, "torque": 3.0}, {"joint_torque": 3.0}, {TRANSMISSION: [[-math.tanh(1.0)]]}, 1e-6),
        Reference(  # y = 1: x = 1 - 0.5 tanh 1
            {"form": WINDUP, "torque": 1.0, "steepening": 0.5},
            {"joint_torque": -(1.0 - 0.5 * math.tanh(1.0))},
            {TRANSMISSION: [[math.tanh(1.0)]]},
            1e-6,
        ),
    )
    examples = (
        {"stiffness_cubic": 4e11},
        {"windup_depth": 5e-5, "windup_width": 2e-4, "windup_steepening": 0.4},
    )

    @classmethod
    def needs(cls) -> tuple[Need, ...]:
        return (LOADED, *super().needs(), BOTH_SIGNS)

    @classmethod
    def shapes(cls, states: DriveStates) -> Sequence[Shape]:
        hard = [
            {"form": HARDENING, "hardening": r, "scale": states.torque_scale} for r in (0.03, 0.1, 0.25, 0.6, 1.3, 2.6)
        ]
        soft = [
            {"form": WINDUP, "torque": share * states.torque_scale, "steepening": steepening}
            for share in (0.06, 0.085, 0.12, 0.17, 0.24, 0.34)
            for steepening in STEEPENINGS
        ]
        return (*hard, *soft)

    @classmethod
    def shape_bounds(cls, shape: Shape, states: DriveStates) -> dict[str, tuple[float, float]]:
        if shape["form"] == HARDENING:
            return {"hardening": (1e-3, 20.0)}
        return {"torque": (0.04 * states.torque_scale, 1.0 * states.torque_scale), "steepening": (-2.0, STEEPEST)}

    @classmethod
    def coefficient_names(cls, shape: Shape) -> tuple[str, ...]:
        return ("compliance",) if shape["form"] == HARDENING else ("depth",)

    @classmethod
    def columns(cls, states: DriveStates, shape: Shape) -> Columns:
        tau = states.elastic_torque
        if shape["form"] == HARDENING:
            scale = float(shape["scale"])
            x = tau / scale
            return {TRANSMISSION: (scale * (x - _inverse(x, float(shape["hardening"]))))[:, None]}
        return {TRANSMISSION: -_soft(tau / float(shape["torque"]), float(shape.get("steepening", 0.0)))[:, None]}

    @classmethod
    def split(cls, values: Mapping[str, float], context: Context) -> tuple[Shape, FloatArray]:
        k = context.torsional_stiffness
        if values.get("windup_depth", 0.0) != 0.0:
            shape = {"form": WINDUP, "torque": k * values["windup_width"]}
            return {**shape, "steepening": values.get("windup_steepening", 0.0)}, np.array([values["windup_depth"]])
        r = values.get("stiffness_cubic", 0.0) * context.torque_scale**2 / k**3
        shape = {"form": HARDENING, "hardening": r, "scale": context.torque_scale}
        return shape, np.array([1.0 / k])

    @classmethod
    def join(cls, shape: Shape, coefficients: FloatArray, context: Context) -> dict[str, float]:
        k, value = context.torsional_stiffness, float(coefficients[0])
        if shape["form"] == WINDUP:
            width, steepening = float(shape["torque"]) / k, float(shape.get("steepening", 0.0))
            return {"windup_depth": value, "windup_width": width, "windup_steepening": steepening}
        # The share k * compliance of the hardening curve is what the data show of it; its cubic start is m2.
        return {"stiffness_cubic": value * k * float(shape["hardening"]) * k**3 / float(shape["scale"]) ** 2}
