"""Parameters of the motion node: the laws' gains, the link model, goals. Values: config/motion_node.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape

LAWS = ("vdc", "pd", "pid", "computed_torque", "feed_forward")
RATE_SOURCES = ("plain", "error_filter")
TABLE_2, CHOSEN = "Zhu, Table II", "chosen"


def _joint(
    name: str, meaning: str, unit: str, symbol: str = "", source: str = TABLE_2, *, above: bool = True, hot: bool = True
) -> Parameter:
    change = Change.HOT if hot else Change.INACTIVE
    return Parameter(
        name, meaning, unit, shape=Shape.PER_JOINT, low=0.0, open_low=above, symbol=symbol, source=source, change=change
    )


def _limit(name: str, meaning: str, unit: str) -> Parameter:
    return _joint(name, meaning, unit, source=CHOSEN, hot=False)


def _integral_rule(values: Mapping[str, Any]) -> list[str]:
    rows = zip(values["joint_names"], values["integral_low"], values["integral_high"], strict=True)
    return [
        f"{joint}: integral_low {low:g} and integral_high {high:g} do not enclose 0"
        for joint, low, high in rows
        if not low < 0.0 < high
    ]


def _link_rule(values: Mapping[str, Any]) -> list[str]:
    low, high = values["link_parameter_low_factor"], values["link_parameter_high_factor"]
    if not low < high:
        return [f"link_parameter_low_factor {low:g} is not below link_parameter_high_factor {high:g}"]
    return [
        f"link_parameter_scale[{i}]: {scale:g} is outside the bounds [{low:g}, {high:g}] of adaptation"
        for i, scale in enumerate(values["link_parameter_scale"])
        if not low <= scale <= high
    ]


def _names_rule(values: Mapping[str, Any]) -> list[str]:
    names = list(values["joint_names"])
    return [
        f"joint_names: {name} is named {names.count(name)} times" for name in {n for n in names if names.count(n) > 1}
    ]


PARAMETERS = ParameterSet(
    "motion",
    (
        Parameter("robot", "robot description: shipped name or URDF file", kind=str, change=Change.FIXED),
        Parameter(
            "joint_names", "joints that the lists below are for", kind=str, shape=Shape.LIST, change=Change.FIXED
        ),
        Parameter("law", "motion law", kind=str, choices=LAWS),
        Parameter("rate_source", "where the joint velocity comes from", kind=str, choices=RATE_SOURCES),
        Parameter(
            "derivative_cutoff",
            "cutoff of the derivative filter of the error filter",
            "rad/s",
            low=0.0,
            open_low=True,
            symbol="omega",
            source="Zhu, section V",
        ),
        _joint("position_gain", "position error to required velocity", "1/s", "lambda"),
        _joint("velocity_gain", "feedback of the required velocity error", "N m s", "k_p"),
        _joint("integral_gain", "bounded integral of the required velocity error", "N m", "k_I", above=False),
        Parameter(
            "integral_low",
            "lower bound of the integral",
            "N m",
            shape=Shape.PER_JOINT,
            symbol="t_s-",
            source=TABLE_2,
            change=Change.HOT,
        ),
        Parameter(
            "integral_high",
            "upper bound of the integral",
            "N m",
            shape=Shape.PER_JOINT,
            symbol="t_s+",
            source=TABLE_2,
            change=Change.HOT,
        ),
        _joint(
            "rotor_inertia", "rotor inertia, output side (computed_torque, feed_forward)", "kg m^2", "I*", above=False
        ),
        Parameter("link_adaptation", "whether link parameters adapt", kind=bool, change=Change.HOT),
        _joint(
            "link_adaptation_gain",
            "adaptation gain of a link parameter over its size",
            "1/J",
            "rho_L/|theta_L|",
            CHOSEN,
            above=False,
        ),
        Parameter(
            "link_parameter_scale",
            "start of the link parameters over the robot description",
            shape=Shape.LIST,
            source=CHOSEN,
        ),
        Parameter(
            "link_parameter_low_factor", "lower bound over the robot description", low=0.0, high=1.0, source=CHOSEN
        ),
        Parameter("link_parameter_high_factor", "upper bound over the robot description", low=1.0, source=CHOSEN),
        _limit("velocity_limit", "largest speed of a goal's path", "rad/s"),
        _limit("acceleration_limit", "largest acceleration of a goal's path", "rad/s^2"),
        _limit("goal_start_tolerance", "largest distance of a goal's start from the measured position", "rad"),
        _limit("goal_start_speed_tolerance", "largest speed difference of a goal's start from the reference", "rad/s"),
        Parameter(
            "goal_blend_time", "time to fade in the distance to a goal", "s", low=0.0, open_low=True, source=CHOSEN
        ),
        Parameter("allow_partial_goals", "whether a goal may leave joints out", kind=bool),
    ),
    (_names_rule, _integral_rule, _link_rule),
)
