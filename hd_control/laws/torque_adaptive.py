"""Parameters of the adaptive joint torque control of Zhu, section III, and the rules between them.

Values live in config/torque_node.yaml (Zhu, Tables I and II). The law itself is hd_control/cpp/torque_adaptive.hpp;
what it does and why is in docs/equations/adaptive_torque_law.md. Words for Zhu's letters: `Parameter.symbol`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_control import _laws
from hd_control.core.parameters import JOINT_NAMES, Change, Parameter, ParameterSet, Shape, parameters_of

LOOP_WARNING = 0.5
TABLE_1, TABLE_2 = "Zhu, Table I", "Zhu, Table II"
FIELDS, ALLOWED = _laws.BLOCKS["TorqueParams"], _laws.ALLOWED["TorqueParams"]
HARMONICS = next(per_joint for name, per_joint, _, _ in FIELDS if name == "kinematic_cosine")
LAWS = (*ALLOWED["law"][4], "integral_manifold", "torque_feedback")
"""The laws of this block, and those that have a block of their own."""


def loop_gains(values: Mapping[str, Any]) -> list[float]:
    """k_f d lambda_tau of every joint: the gain of the algebraic loop, Zhu, Remark 3.1. No unit."""
    rows = zip(values["torsional_stiffness"], values["damping_time"], values["torque_rate_gain"], strict=True)
    return [float(stiffness * time * gain) for stiffness, time, gain in rows]


def _names(values: Mapping[str, Any]) -> list[str]:
    return list(values["joint_names"])


def _loop_rule(values: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: k_f·d·λ_τ = {gain:.3g} ≥ 1 (Zhu, Remark 3.1): lower torque_rate_gain below "
        f"{values['torque_rate_gain'][j] / gain:.3g}"
        for j, (name, gain) in enumerate(zip(_names(values), loop_gains(values), strict=True))
        if not gain < 1.0
    ]


def warnings(values: Mapping[str, Any]) -> list[str]:
    """What is allowed but deserves a word, one sentence each."""
    return [
        f"{name}: k_f·d·λ_τ = {gain:.3g} ≥ {LOOP_WARNING} (Zhu, Remark 3.1): an extra sample of delay may make the "
        f"torque loop unstable; stay below {LOOP_WARNING * values['torque_rate_gain'][j] / gain:.3g} if you can"
        for j, (name, gain) in enumerate(zip(_names(values), loop_gains(values), strict=True))
        if LOOP_WARNING <= gain < 1.0
    ]


_STARTS = {
    "coulomb_torque": ("coulomb_torque",),
    "friction_offset": ("friction_offset",),
    "viscous": ("viscous_positive", "viscous_negative"),
    "torsional_compliance": ("torsional_compliance",),
}
"""Bounded estimate -> the estimates that share its bounds."""
_SYMBOLS = {"coulomb_torque": "θ_1", "friction_offset": "θ_2", "viscous": "θ_3,4", "torsional_compliance": "ζ"}


def _bounds_rule(values: Mapping[str, Any]) -> list[str]:
    found = []
    for name, starts in _STARTS.items():
        for j, joint in enumerate(_names(values)):
            low, high = values[f"{name}_low"][j], values[f"{name}_high"][j]
            if not low < high:
                found.append(f"{joint}: {name}_low {low:g} is not below {name}_high {high:g}")
            for start in starts:
                begin = values[f"{start}_initial"][j]
                if low < high and not low <= begin <= high:
                    found.append(f"{joint}: {start}_initial {begin:g} is outside [{low:g}, {high:g}], its bounds")
    return found


def _compliance_rule(values: Mapping[str, Any]) -> list[str]:
    found = []
    for j, joint in enumerate(_names(values)):
        low, high = values["torsional_compliance_low"][j], values["torsional_compliance_high"][j]
        compliance = 1.0 / values["torsional_stiffness"][j]
        if not low <= compliance <= high:
            found.append(
                f"{joint}: 1 / torsional_stiffness = {compliance:.4g} rad/(N m) is outside the bounds of the "
                f"compliance estimate [{low:g}, {high:g}]"
            )
    return found


def _literal_rule(values: Mapping[str, Any]) -> list[str]:
    if values["compliance_derivative"] != "literal":
        return []
    return [
        f"{joint}: compliance_derivative literal divides by damping_time; it must be above 0"
        for joint, time in zip(_names(values), values["damping_time"], strict=True)
        if not time > 0.0
    ]


def _subset_rule(values: Mapping[str, Any]) -> list[str]:
    names = _names(values)
    strangers = [name for name in values["joints"] if name and name not in names]
    found = [f"joints: {name!r} is not one of {', '.join(names)}" for name in strangers]
    for key in ("joint_names", "joints"):
        listed = [name for name in values[key] if name]
        if len(set(listed)) != len(listed):
            found.append(f"{key}: a joint is named twice")
    return found


_HOT: Mapping[str, Any] = {"change": Change.HOT}
_GAIN: Mapping[str, Any] = {"change": Change.HOT, "source": TABLE_2}
_START: Mapping[str, Any] = {"change": Change.HOT, "source": "Zhu: 0, or identified"}
_MORE: Mapping[str, Mapping[str, Any]] = {
    "law": {"choices": LAWS},
    "kinematic_feedforward": _HOT,
    "adapt_friction": _HOT,
    "adapt_compliance": _HOT,
    "derivative_cutoff": {"symbol": "ω", "source": "Zhu, section V"},
    "gear_ratio": {"symbol": "N", "source": TABLE_1},
    "damping_time": {"symbol": "d", "source": TABLE_2},
    "rotor_inertia": {"symbol": "I*", "source": TABLE_2},
    "motor_position_gain": {"symbol": "λ_φ", **_GAIN},
    "torque_rate_gain": {"symbol": "λ_τ", **_GAIN},
    "motor_velocity_gain": {"symbol": "k_φ", **_GAIN},
    "torque_gain": {"symbol": "k_τ", **_GAIN},
    "load_friction_linear": {"symbol": "g_1", "source": "chosen", **_HOT},
    "load_friction_quadratic": {"symbol": "g_2", "source": "chosen", **_HOT},
    "adaptation_gain_coulomb": {"symbol": "ρ_1", **_GAIN},
    "adaptation_gain_offset": {"symbol": "ρ_2", **_GAIN},
    "adaptation_gain_viscous": {"symbol": "ρ_3 = ρ_4", **_GAIN},
    "adaptation_gain_compliance": {"symbol": "ρ_ζ", **_GAIN},
    **{
        f"{name}_{end}": {"symbol": _SYMBOLS[name] + sign, **_GAIN}
        for name in _STARTS
        for end, sign in (("low", "-"), ("high", "+"))
    },
    **{f"{start}_initial": {"symbol": f"{_SYMBOLS[name]}(0)", **_START} for name in _STARTS for start in _STARTS[name]},
    "motor_torque_limit": {"symbol": "u_max", "source": "chosen"},
    "kinematic_cosine": {"symbol": "a_n", "source": "identified", **_HOT},
    "kinematic_sine": {"symbol": "b_n", "source": "identified", **_HOT},
}
_STIFFNESS = [field for field in _laws.BLOCKS["FeedbackParams"] if field[0] == "torsional_stiffness"]

PARAMETERS = ParameterSet(
    "torque law",
    (
        JOINT_NAMES,
        Parameter("joints", "joints to control; none named: all", kind=str, shape=Shape.LIST, change=Change.FIXED),
        Parameter(
            "plug_in",
            "law in Python in place of `law`, by its name in the entry-point group hd_control.laws; empty: none",
            kind=str,
            change=Change.FIXED,
        ),
        *parameters_of(FIELDS, ALLOWED, _MORE, live=_laws.LIVE["TorqueParams"]),
        # Of no field of this law: a factor on three gains, and what its rules compare with.
        Parameter(
            "adaptation_scale",
            "factor on Coulomb, viscous, compliance gains",
            low=0.0,
            high=10.0,
            change=Change.HOT,
            live=(10.0, 0.1),
            source="chosen",
        ),
        *parameters_of(
            _STIFFNESS,
            _laws.ALLOWED["FeedbackParams"],
            {},
            live=_laws.LIVE["FeedbackParams"],
            symbol="k_f",
            source=TABLE_1,
            change=Change.HOT,
        ),
    ),
    (_loop_rule, _bounds_rule, _compliance_rule, _literal_rule, _subset_rule),
)
