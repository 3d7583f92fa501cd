"""Motion law: from the desired motion to the joint torque required. `law`:

- `vdc`: virtual decomposition control, Zhu, section IV; the torque law `adaptive` turns its output into motor torque;
- `pd`, `pid`, `computed_torque`, `feed_forward`: laws to compare with. They command the motor, through the torque law
  `direct`.

`reference.feed_forward_torque`, zero unless the caller sets it, is added to the output of every law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape, field_numbers, parameters_of
from hd_control.core.robot import Robot

# ---- The link model of virtual decomposition control, and the torque of the rigid arm --------------
#
# Zhu, section IV: each link has 13 parameters theta_L (`Robot.link_parameters`), each with an adaptation gain and
# bounds.


LINK_PARAMETERS = 13
GRAVITY = 9.81
"""m/s^2; the arm stands upright."""


def link_scale(scale: Sequence[float], joints: int) -> FloatArray:
    """`link_parameter_scale` as (n, 13): one factor for all, one for each joint, or one for each parameter.

    Raises ConfigError for any other length.
    """
    factors = np.array(scale, dtype=float)
    if factors.size == 1:
        return np.full((joints, LINK_PARAMETERS), factors.item())
    if factors.size == joints:
        return np.repeat(factors[:, None], LINK_PARAMETERS, axis=1)
    if factors.size == joints * LINK_PARAMETERS:
        return factors.reshape(joints, LINK_PARAMETERS)
    raise ConfigError(
        f"motion: link_parameter_scale has {factors.size} values, expected 1, {joints} or {joints * LINK_PARAMETERS}"
    )


def link_fields(values: Mapping[str, Any], robot: Robot) -> dict[str, ArrayLike]:
    """The robot's part of the parameter block: geometry, link parameters at the start, bounds, adaptation gains.

    `values` are in the robot's joint order. Bounds and gains belong to the robot description, the start value is the
    description's times `link_parameter_scale`. A parameter that is zero stays zero.
    """
    joints, theta = robot.joints, robot.link_parameters()
    factors = link_scale(values["link_parameter_scale"], joints)
    ends = [values["link_parameter_low_factor"] * theta, values["link_parameter_high_factor"] * theta]
    gain = np.asarray(values["link_adaptation_gain"], dtype=float)
    return {
        "gravity": GRAVITY,
        "rotation": robot.rotation.reshape(joints, 9),
        "origin": robot.origin,
        "link_parameters": factors * theta,
        "link_parameters_low": np.minimum(*ends),
        "link_parameters_high": np.maximum(*ends),
        "link_adaptation_gain": gain[:, None] * np.abs(theta),
    }


def rigid_torque(
    robot: Robot,
    position: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    required_velocity: ArrayLike | None = None,
) -> FloatArray:
    """Joint torques (k, n) of the robot without drives, N m, for k states (k, n); Zhu (36), (39).

    `required_velocity` None means equal to `velocity`: then this is the inverse dynamics. Otherwise `acceleration` is
    the required one. Raises ValueError for shapes that do not fit.
    """
    q, v, a = (np.ascontiguousarray(x, dtype=float) for x in (position, velocity, acceleration))
    v_r = v if required_velocity is None else np.ascontiguousarray(required_velocity, dtype=float)
    found: FloatArray = _laws.batch_torque(
        robot.joints, robot.rotation, robot.origin, GRAVITY, robot.link_parameters(), q, v, v_r, a
    )
    return found


# ---- Parameters of the motion node: gains of the laws, link model, goals; values in config/motion_node.yaml ----


FIELDS, ALLOWED = _laws.BLOCKS["MotionParams"], _laws.ALLOWED["MotionParams"]
LAWS = ALLOWED["law"][4]
_OF_THE_ROBOT = (
    *("gravity", "rotation", "origin"),
    *("link_parameters", "link_parameters_low", "link_parameters_high", "link_adaptation_gain"),
)
"""Fields that `link_fields` makes from the robot description."""
TABLE_2, CHOSEN = "Zhu, Table II", "chosen"


def _joint(
    name: str, meaning: str, unit: str, symbol: str = "", source: str = TABLE_2, *, above: bool = True, hot: bool = True
) -> Parameter:
    change, live = (Change.HOT, (10.0, 0.0)) if hot else (Change.INACTIVE, None)
    return Parameter(
        name, meaning, unit, shape=Shape.PER_JOINT, low=0.0, open_low=above, symbol=symbol, source=source,
        change=change, live=live,
    )  # fmt: skip


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


_GAIN: Mapping[str, Any] = {"source": TABLE_2, "change": Change.HOT}
_MORE: Mapping[str, Mapping[str, Any]] = {
    "derivative_cutoff": {"symbol": "ω", "source": "Zhu, section V"},
    "position_gain": {"symbol": "lambda", **_GAIN},
    "velocity_gain": {"symbol": "k_p", **_GAIN},
    "integral_gain": {"symbol": "k_I", **_GAIN},
    "integral_low": {"symbol": "t_s-", **_GAIN},
    "integral_high": {"symbol": "t_s+", **_GAIN},
    "rotor_inertia": {"symbol": "I*", **_GAIN},
    "link_adaptation": {"change": Change.HOT},
}
PARAMETERS = ParameterSet(
    "motion",
    (
        Parameter("robot", "robot description: shipped name or URDF file", kind=str, change=Change.FIXED),
        Parameter(
            "joint_names", "joints that the lists below are for", kind=str, shape=Shape.LIST, change=Change.FIXED
        ),
        *parameters_of(FIELDS, ALLOWED, _MORE, _OF_THE_ROBOT, _laws.LIVE["MotionParams"]),
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


# ---- The law ---------------------------------------------------------------------------------------


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of MotionParams, MotionSample, MotionReference, MotionState or MotionOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def in_robot_order(values: Mapping[str, Any], robot: Robot) -> dict[str, Any]:
    """Checked values with every list in the robot's joint order. Raises ConfigError with all problems."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    names = list(own.get("joint_names", ()))
    PARAMETERS.check(own, len(names))
    strangers = sorted(set(names) - set(robot.joint_names))
    if strangers:
        what = f"{robot.name} has no joint {strangers[0]}; it has {', '.join(robot.joint_names)}"
        raise ConfigError(FaultCode.MODEL_MISMATCH.line(what, "motion"))
    ordered = PARAMETERS.select(own, robot.joint_names)
    scale = own["link_parameter_scale"]
    if len(scale) in (len(names), LINK_PARAMETERS * len(names)):
        rows = np.array(scale).reshape(len(names), -1)
        ordered["link_parameter_scale"] = rows[[names.index(name) for name in robot.joint_names]].ravel().tolist()
    return ordered


def configure(values: Mapping[str, Any], robot: Robot, dt: float) -> Block:
    """Parameter block for all joints of the robot, in its order. Raises ConfigError with every problem.

    A new block may take the place of an old one at any time: the state goes on.
    """
    chosen = in_robot_order(values, robot)
    if not chosen["derivative_cutoff"] < math.pi / dt:
        raise ConfigError(
            f"motion: derivative_cutoff {chosen['derivative_cutoff']:g} rad/s is not below {math.pi / dt:g} rad/s, "
            "half the sample rate"
        )
    fast = [
        f"{name}: velocity_limit {limit:g} is above {most:g} rad/s of the robot description"
        for name, limit, most in zip(robot.joint_names, chosen["velocity_limit"], robot.velocity_limit, strict=True)
        if limit > most
    ]
    if fast:
        raise ConfigError(FaultCode.MODEL_MISMATCH.line("; ".join(fast), "motion"))
    numbers = field_numbers(FIELDS, ALLOWED, chosen) | link_fields(chosen, robot)
    return layout("MotionParams", robot.joints).pack(numbers)


def new_sample(joints: int) -> Block:
    """Empty MotionSample block."""
    return layout("MotionSample", joints).zeros()


def new_reference(joints: int) -> Block:
    """Empty MotionReference block."""
    return layout("MotionReference", joints).zeros()


def initial_state(params: Block, sample: Block | None = None) -> Block:
    """Link parameters at their start values; the filter fills with the first sample and reference that `step` sees."""
    state = layout("MotionState", params.joints).zeros()
    state.link_parameters = params.link_parameters
    return state


def restarted(state: Block) -> Block:
    """The state after a stop: link parameters kept, integral and filter filled anew with the next sample."""
    new = layout("MotionState", state.joints).zeros()
    new.link_parameters = state.link_parameters
    return new


def step(params: Block, state: Block, sample: Block, reference: Block, dt: float) -> tuple[Block, Block]:
    """One sample of `dt` s. Returns (MotionOutput, new MotionState); the inputs stay as they were.

    Inputs that are not finite give torques that are not finite (the gate stops on them) and leave the state as it was.
    """
    joints = params.layout.joints
    outputs = layout("MotionOutput", joints)
    output, new_state = Block(outputs, np.empty(outputs.size)), Block(state.layout, np.empty(state.layout.size))
    _laws.motion_step(
        params.array, state.array, sample.array, reference.array, output.array, new_state.array, joints, dt
    )
    return output, new_state


__all__ = [
    "LAWS",
    "PARAMETERS",
    "configure",
    "in_robot_order",
    "initial_state",
    "layout",
    "new_reference",
    "new_sample",
    "restarted",
    "step",
]
