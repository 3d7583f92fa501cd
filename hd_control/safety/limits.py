"""Limits of gate, guard and monitors: parameters, blocks, and the file that a node names (config/limits.yaml)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.parameters import JOINT_NAMES, Change, Parameter, ParameterSet, Shape, parameters_of
from hd_control.core.resources import find_config
from hd_control.core.strict_yaml import load_params_file

_NAMES: Mapping[str, Mapping[str, Any]] = {
    "age_limit": {"name": "age_limit_samples"},
    "torque_limit": {"name": "motor_torque_limit", "symbol": "u_max"},
}
GATE_PARAMETERS = ParameterSet(
    "safety gate",
    (
        JOINT_NAMES,
        *parameters_of(_laws.BLOCKS["GateLimits"], _laws.ALLOWED["GateLimits"], _NAMES, ("torque_step",)),
        Parameter(  # gives torque_step
            "motor_torque_rate_limit",
            "largest rate of the motor torque",
            "N m/s",
            shape=Shape.PER_JOINT,
            low=0.0,
            open_low=True,
            symbol="u'_max",
        ),
    ),
)


@lru_cache
def limits_layout(joints: int) -> Layout:
    """Layout of the limits block."""
    return layout_of("GateLimits", _laws.BLOCKS["GateLimits"], joints)


def configure_gate(values: Mapping[str, Any], dt: float) -> Block:
    """Checked limits as a block; the rate limit becomes a step per sample of `dt` s. Raises ConfigError."""
    own = {name: values[name] for name in GATE_PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    GATE_PARAMETERS.check(own, joints)
    return limits_layout(joints).pack(
        {
            "age_limit": float(own["age_limit_samples"]),
            "rate_excess_limit": float(own["rate_excess_limit"]),
            "reset_samples": float(own["reset_samples"]),
            "standstill_velocity": own["standstill_velocity"],
            "torque_limit": own["motor_torque_limit"],
            "torque_step": np.asarray(own["motor_torque_rate_limit"]) * dt,
        }
    )


GUARD_PARAMETERS = ParameterSet(
    "guard",
    parameters_of(
        _laws.BLOCKS["GuardLimits"], _laws.ALLOWED["GuardLimits"], {"stop_deceleration": {"symbol": "a_brake"}}
    ),
)


@dataclass(frozen=True)
class SafetyLimits:
    """What one limits file says for some joints: blocks of the gate and of the guard."""

    gate: Block
    guard: Block

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.gate.joints


@lru_cache
def guard_layout(joints: int) -> Layout:
    """Layout of the guard's limits."""
    return layout_of("GuardLimits", _laws.BLOCKS["GuardLimits"], joints)


def configure(values: Mapping[str, Any], dt: float) -> SafetyLimits:
    """Checked limits of a complete limits file. Raises ConfigError with every problem, unknown names included."""
    names = (*GATE_PARAMETERS.names, *GUARD_PARAMETERS.names)
    own = {name: values[name] for name in GUARD_PARAMETERS.names if name in values}
    strangers = {name: value for name, value in values.items() if name not in names}
    GUARD_PARAMETERS.check(own | strangers, len(values.get("joint_names", ())))
    guard = guard_layout(len(values["joint_names"])).pack({name: own[name] for name in GUARD_PARAMETERS.names})
    return SafetyLimits(configure_gate(values, dt), guard)


def select(values: Mapping[str, Any], joint_names: list[str]) -> dict[str, Any]:
    """The values of some joints only. Raises ConfigError for a joint without values."""
    both = ParameterSet("limits", (*GATE_PARAMETERS.parameters, *GUARD_PARAMETERS.parameters))
    return both.select(values, joint_names)


# ---- The limits of some joints, from the file that a node names ------------------------------------


LIMITS = Parameter(
    "limits", "file with the limits of safety gate and monitors: shipped name or path", kind=str, change=Change.FIXED
)


def safety_limits(name_or_path: str, joint_names: Sequence[str], dt: float) -> SafetyLimits:
    """The limits for these joints. Raises ConfigError for a bad file or a joint without limits."""
    values = load_params_file(find_config(name_or_path), "limits")
    return configure(select(values, list(joint_names)), dt)
