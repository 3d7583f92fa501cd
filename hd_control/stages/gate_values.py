"""Limits of the safety gate for some joints, from the limits file that a node names."""

from __future__ import annotations

from collections.abc import Sequence

from hd_control.control import gate_limits
from hd_control.core.blocks import Block
from hd_control.core.parameters import Change, Parameter
from hd_control.core.resources import find_config
from hd_control.core.strict_yaml import load_params_file

LIMITS = Parameter(
    "limits", "file with the limits of the safety gate: shipped name or path", kind=str, change=Change.FIXED
)


def limits_block(name_or_path: str, joint_names: Sequence[str], dt: float) -> Block:
    """The gate's limits for these joints. Raises ConfigError for a bad file or a joint without limits."""
    values = load_params_file(find_config(name_or_path), "limits")
    return gate_limits.configure(gate_limits.PARAMETERS.select(values, joint_names), dt)
