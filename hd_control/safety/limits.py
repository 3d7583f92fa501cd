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


def _per_joint(name: str, meaning: str, unit: str, symbol: str = "") -> Parameter:
    return Parameter(name, meaning, unit, shape=Shape.PER_JOINT, low=0.0, open_low=True, symbol=symbol)


def _samples(name: str, meaning: str) -> Parameter:
    return Parameter(name, meaning, "samples", int, low=1, high=10**6)


_NAMES: Mapping[str, Mapping[str, Any]] = {
    "age_limit": {"name": "age_limit_samples"},
    "torque_limit": {"name": "motor_torque_limit", "symbol": "u_max"},
}
GATE_PARAMETERS = ParameterSet(
    "safety gate",
    (
        JOINT_NAMES,
        *parameters_of(_laws.BLOCKS["GateLimits"], _laws.ALLOWED["GateLimits"], _NAMES, ("torque_step",)),
        _per_joint("motor_torque_rate_limit", "largest rate of the motor torque", "N m/s", "u'_max"),
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
    (
        _samples("degrade_gap_samples", "lost ticks in a row that freeze the adaptation"),
        _samples("recover_samples", "healthy samples in a row that end it"),
        _samples("brake_samples", "longest hold of the drive side while the brakes close"),
        _samples("rejected_samples", "bad readings in a row that stop the robot"),
        _samples("disagree_samples", "samples of disagreeing sensors that stop the robot"),
        _samples("frozen_samples", "equal readings in motion that stop the robot"),
        _samples("rail_degrade_samples", "gauge readings at the rail that freeze the adaptation"),
        _samples("rail_samples", "gauge readings at the rail that stop the robot"),
        Parameter("adaptation_time", "time at a bound before a growing error counts", "s", low=0.01, high=1e3),
        _per_joint("stop_deceleration", "of a controlled stop", "rad/s^2", "a_brake"),
        _per_joint("stop_damping", "of a controlled stop, on the motor side", "N m s/rad"),
        _per_joint("stop_stiffness", "of the hold after a controlled stop, on the motor side", "N m/rad"),
        _per_joint("position_step_limit", "largest jump of a position reading against its prediction", "rad"),
        _per_joint("gauge_step_limit", "largest jump of a gauge reading against its prediction", "N m"),
        _per_joint("gauge_rail", "a larger gauge reading is at its rail", "N m"),
        _per_joint("twist_limit", "largest difference of motor and joint position", "rad"),
        _per_joint(
            "stuck_motion_limit", "motion that the others show while a position sensor repeats one reading", "rad"
        ),
        _per_joint("residual_limit", "largest mean residual of the three sensors over a motor turn", "N m"),
        _per_joint("ripple_limit", "largest 2 beta amplitude of that residual", "N m"),
    ),
)
_FIELDS = tuple((p.name, int(p.shape is Shape.PER_JOINT), p.unit, p.meaning) for p in GUARD_PARAMETERS.parameters)


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
    return layout_of("GuardLimits", _FIELDS, joints)


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
