"""Motion law: from the desired motion to the joint torque required. `law`:

- `vdc`: virtual decomposition control, Zhu, section IV; the torque law `adaptive` turns its output into motor torque;
- `pd`, `pid`, `computed_torque`, `feed_forward`: laws to compare with. They command the motor, through the torque law
  `direct`.

`reference.feed_forward_torque` is added to the output of every law; `hd_control.control.compensation` can supply it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _motion
from hd_control.control.motion_parameters import LAWS, PARAMETERS, RATE_SOURCES
from hd_control.control.motion_vdc import LINK_PARAMETERS, link_fields
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot

_GAINS = ("position_gain", "velocity_gain", "integral_gain", "integral_low", "integral_high", "rotor_inertia")


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of MotionParams, MotionSample, MotionReference, MotionState or MotionOutput."""
    return layout_of(block, _motion.BLOCKS[block], joints)


def in_robot_order(values: Mapping[str, Any], robot: Robot) -> dict[str, Any]:
    """Checked values with every list in the robot's joint order. Raises ConfigError with all problems."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    names = list(own.get("joint_names", ()))
    PARAMETERS.check(own, len(names))
    strangers = sorted(set(names) - set(robot.joint_names))
    if strangers:
        raise ConfigError(f"motion: {robot.name} has no joint {strangers[0]}; it has {', '.join(robot.joint_names)}")
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
        raise ConfigError("motion: " + "; ".join(fast))
    numbers: dict[str, Any] = {name: chosen[name] for name in _GAINS} | link_fields(chosen, robot)
    numbers["law"] = LAWS.index(chosen["law"])
    numbers["rate_source"] = RATE_SOURCES.index(chosen["rate_source"])
    numbers["derivative_cutoff"] = chosen["derivative_cutoff"]
    numbers["link_adaptation"] = float(chosen["link_adaptation"])
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
    _motion.step(params.array, state.array, sample.array, reference.array, output.array, new_state.array, joints, dt)
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
