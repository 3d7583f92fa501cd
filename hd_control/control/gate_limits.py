"""Limits of the safety gate: parameters and the block that the gate reads. Shipped values: config/limits.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _torque
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape


def _per_joint(name: str, meaning: str, unit: str, symbol: str) -> Parameter:
    return Parameter(name, meaning, unit, shape=Shape.PER_JOINT, low=0.0, open_low=True, symbol=symbol)


PARAMETERS = ParameterSet(
    "safety gate",
    (
        Parameter("joint_names", "joints, in the order of every list", kind=str, shape=Shape.LIST, change=Change.FIXED),
        _per_joint("motor_torque_limit", "largest motor torque, output side", "N m", "u_max"),
        _per_joint("motor_torque_rate_limit", "largest rate of the motor torque", "N m/s", "u'_max"),
        Parameter("age_limit_samples", "inputs of this age stop the robot", "samples", int, low=1, high=1000),
        Parameter("rate_excess_limit", "rate excesses in a row that stop the robot", "samples", int, low=1, high=1000),
        Parameter("reset_samples", "healthy samples in a row before a reset", "samples", int, low=2, high=10**6),
        Parameter("standstill_velocity", "a faster joint refuses a reset", "rad/s", low=0.0, high=0.1, open_low=True),
    ),
)


@lru_cache
def limits_layout(joints: int) -> Layout:
    """Layout of the limits block."""
    return layout_of("GateLimits", _torque.BLOCKS["GateLimits"], joints)


def configure(values: Mapping[str, Any], dt: float) -> Block:
    """Checked limits as a block; the rate limit becomes a step per sample of `dt` s. Raises ConfigError."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    PARAMETERS.check(own, joints)
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
