"""Limits of gate, guard and monitors for some joints, from the limits file that a node names."""

from __future__ import annotations

from collections.abc import Sequence

from hd_control.control import guard_limits
from hd_control.control.guard_limits import SafetyLimits
from hd_control.core.parameters import Change, Parameter
from hd_control.core.resources import find_config
from hd_control.core.strict_yaml import load_params_file

LIMITS = Parameter(
    "limits", "file with the limits of safety gate and monitors: shipped name or path", kind=str, change=Change.FIXED
)


def safety_limits(name_or_path: str, joint_names: Sequence[str], dt: float) -> SafetyLimits:
    """The limits for these joints. Raises ConfigError for a bad file or a joint without limits."""
    values = load_params_file(find_config(name_or_path), "limits")
    return guard_limits.configure(guard_limits.select(values, list(joint_names)), dt)
