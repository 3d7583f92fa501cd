"""Parameters of the adaptive joint torque control of Zhu, section III, and the rules between them.

Values live in config/torque_node.yaml (Zhu, Tables I and II). The law itself is hd_control/cpp/torque_adaptive.hpp;
what it does and why is in docs/equations/adaptive_torque_law.md. Words for Zhu's letters: `Parameter.symbol`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape

HARMONICS = 4
COMPLIANCE_DERIVATIVES = ("literal", "stiffness_only", "filtered")
RATE_SOURCES = ("plain", "error_filter")
LAWS = ("adaptive", "direct", "integral_manifold", "torque_feedback")
LOOP_WARNING = 0.5
TABLE_1, TABLE_2 = "Zhu, Table I", "Zhu, Table II"


def _choice(name: str, meaning: str, choices: tuple[str, ...]) -> Parameter:
    return Parameter(name, meaning, kind=str, choices=choices, change=Change.INACTIVE)


def _switch(name: str, meaning: str, change: Change = Change.HOT) -> Parameter:
    return Parameter(name, meaning, kind=bool, change=change)


def _joint(
    name: str,
    meaning: str,
    unit: str,
    symbol: str,
    source: str = TABLE_2,
    low: float = 0.0,
    *,
    above: bool = True,
    change: Change = Change.INACTIVE,
) -> Parameter:
    return Parameter(
        name, meaning, unit, shape=Shape.PER_JOINT, low=low, open_low=above, symbol=symbol, source=source, change=change
    )


def _gain(name: str, meaning: str, unit: str, symbol: str, *, above: bool = True) -> Parameter:
    return _joint(name, meaning, unit, symbol, above=above, change=Change.HOT)


def _load(name: str, meaning: str, unit: str, symbol: str) -> Parameter:
    return _joint(name, meaning, unit, symbol, "chosen", above=False, change=Change.HOT)


def _bounds(name: str, unit: str, symbol: str, starts: tuple[str, ...], low: float = -math.inf) -> list[Parameter]:
    above, source = low == 0.0, "Zhu: 0, or identified"
    limits = [
        _joint(
            f"{name}_{end}",
            f"{end} bound of the estimate",
            unit,
            symbol + sign,
            low=low,
            above=above,
            change=Change.HOT,
        )
        for end, sign in (("low", "-"), ("high", "+"))
    ]
    return limits + [
        _joint(
            f"{start}_initial",
            "estimate at the start; a live change moves the estimate there",
            unit,
            f"{symbol}(0)",
            source,
            low,
            above=False,
            change=Change.HOT,
        )
        for start in starts
    ]


def _harmonics(kind: str, letter: str) -> list[Parameter]:
    return [
        Parameter(
            f"kinematic_{kind}_{n}",
            f"kinematic error, {kind} of {n} rotor angles",
            "rad",
            shape=Shape.PER_JOINT,
            low=-0.1,
            high=0.1,
            symbol=f"{letter}_{n}",
            source="identified",
            change=Change.HOT,
        )  # fmt: skip
        for n in range(1, HARMONICS + 1)
    ]


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


PARAMETERS = ParameterSet(
    "torque law",
    (
        Parameter("joint_names", "joints, in the order of every list", kind=str, shape=Shape.LIST, change=Change.FIXED),
        Parameter("joints", "joints to control; none named: all", kind=str, shape=Shape.LIST, change=Change.FIXED),
        _choice(
            "law", "adaptive joint torque control, required torque sent to the motor as it is, or another law", LAWS
        ),
        _choice("compliance_derivative", "derivatives of the wanted torsion", COMPLIANCE_DERIVATIVES),
        _choice("rate_source", "rates from the measurements, or from the tracking error", RATE_SOURCES),
        _switch("kinematic_feedforward", "take the known kinematic error off the wanted rotor motion"),
        _switch("adapt_friction", "friction estimates follow the error"),
        _switch("adapt_compliance", "the compliance estimate follows the error"),
        Parameter(
            "adaptation_scale",
            "factor on Coulomb, viscous, compliance gains",
            low=0.0,
            high=10.0,
            change=Change.HOT,
            source="chosen",
        ),  # fmt: skip
        Parameter(
            "derivative_cutoff",
            "cut-off of the derivative filter D",
            "rad/s",
            low=0.0,
            open_low=True,
            high=1e5,
            symbol="ω",
            source="Zhu, section V",
        ),  # fmt: skip
        _joint("gear_ratio", "rotor turns per joint turn", "-", "N", TABLE_1),
        _joint(
            "torsional_stiffness", "stiffness of the drive, for the rules", "N m/rad", "k_f", TABLE_1, change=Change.HOT
        ),
        _joint("damping_time", "flexspline damping over stiffness", "s", "d", above=False),
        _joint("rotor_inertia", "rotor inertia, output side", "kg m^2", "I*"),
        _gain("motor_position_gain", "motor position error to velocity", "1/s", "λ_φ"),
        _gain("torque_rate_gain", "joint torque error to velocity", "1/(N m s)", "λ_τ"),
        _gain("motor_velocity_gain", "velocity error to torque", "N m s", "k_φ"),
        _gain("torque_gain", "joint torque error to torque", "-", "k_τ", above=False),
        _load("load_friction_linear", "growth of Coulomb friction with load", "1/(N m)", "g_1"),
        _load("load_friction_quadratic", "growth with load squared", "1/(N m)^2", "g_2"),
        _gain("adaptation_gain_coulomb", "speed of the Coulomb estimate", "N m", "ρ_1", above=False),
        _gain("adaptation_gain_offset", "speed of the offset estimate", "N m", "ρ_2", above=False),
        _gain("adaptation_gain_viscous", "speed of both viscous estimates", "N m s^2", "ρ_3 = ρ_4", above=False),
        _gain("adaptation_gain_compliance", "speed of the compliance estimate", "1/(N m)^2", "ρ_ζ", above=False),
        *_bounds("coulomb_torque", "N m", "θ_1", _STARTS["coulomb_torque"]),
        *_bounds("friction_offset", "N m", "θ_2", _STARTS["friction_offset"]),
        *_bounds("viscous", "N m s", "θ_3,4", _STARTS["viscous"]),
        *_bounds("torsional_compliance", "rad/(N m)", "ζ", _STARTS["torsional_compliance"], low=0.0),
        _joint("motor_torque_limit", "largest motor torque, output side", "N m", "u_max", "chosen"),
        *_harmonics("cosine", "a"),
        *_harmonics("sine", "b"),
    ),
    (_loop_rule, _bounds_rule, _compliance_rule, _literal_rule, _subset_rule),
)
