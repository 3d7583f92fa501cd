"""Torque law: from the required joint torque to the motor torque, `law`:

- `adaptive`: Zhu, section III.
- `direct` sends the required torque to the motor, for motion laws that command the motor themselves.
- `torque_feedback`: Hashimoto (19), laws/torque_feedback.py.
- `integral_manifold`: Gandhi and Ghorbel (26), laws/integral_manifold.py; follows the wanted position itself.

`configure` picks the joints named by `joints` out of the lists of all joints; one joint alone computes the same bits as
among seven. The kind of the parameter block says to `step` which law it belongs to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode
from hd_control.core.parameters import ParameterSet, field_numbers
from hd_control.laws import integral_manifold, torque_adaptive, torque_feedback
from hd_control.laws.torque_adaptive import warnings

PARAMETERS = ParameterSet(
    "torque law",
    tuple(dict.fromkeys((*torque_adaptive.PARAMETERS.parameters, *integral_manifold.OWN, *torque_feedback.OWN))),
    torque_adaptive.PARAMETERS.rules,
)
ESTIMATES = ("coulomb_torque", "friction_offset", "viscous_positive", "viscous_negative", "torsional_compliance")
_OTHER_LAWS: Mapping[str, Any] = {"integral_manifold": integral_manifold, "torque_feedback": torque_feedback}
_LAW_OF_BLOCK: Mapping[str, Any] = {"ManifoldParams": integral_manifold, "FeedbackParams": torque_feedback}
START_VALUES: Mapping[str, str] = {name: f"{name}_initial" for name in ESTIMATES}
"""Field of TorqueState and the parameter that it starts at."""
MODEL_FIELDS = (
    *("kinematic_feedforward", "kinematic_cosine", "kinematic_sine", "load_friction_linear", "load_friction_quadratic"),
    *START_VALUES.values(),
    *("torsional_stiffness", "rotor_coulomb", "rotor_damping", "feedback_friction"),
)
"""Fields of the parameter blocks of all laws that are a model of the drive: a live change ramps."""
_SCALED = ("adaptation_gain_coulomb", "adaptation_gain_viscous", "adaptation_gain_compliance")


class NamedJoints(Protocol):
    """What this law needs of a robot: the names of its joints."""

    @property
    def joint_names(self) -> tuple[str, ...]: ...


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of TorqueParams, TorqueSample, TorqueReference, TorqueState or TorqueOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def selected_joints(values: Mapping[str, Any]) -> list[str]:
    """Names of the joints that the law runs, in the order of its blocks."""
    return [name for name in values["joints"] if name] or list(values["joint_names"])


def configure(values: Mapping[str, Any], robot: NamedJoints | None, dt: float) -> Block:
    """Parameter block of the selected joints. Raises ConfigError with every problem; see also `warnings`.

    A new block may take the place of an old one at any time: the state goes on.
    """
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    PARAMETERS.check(own, len(own.get("joint_names", ())))
    if not own["derivative_cutoff"] < math.pi / dt:
        raise ConfigError(
            f"{PARAMETERS.owner}: derivative_cutoff {own['derivative_cutoff']:g} rad/s is not below "
            f"{math.pi / dt:g} rad/s, half the sample rate"
        )
    strangers = [name for name in own["joint_names"] if robot is not None and name not in robot.joint_names]
    if robot is not None and strangers:
        known = ", ".join(robot.joint_names)
        what = f"the robot has no joint {strangers[0]}; it has {known}"
        raise ConfigError(FaultCode.MODEL_MISMATCH.line(what, PARAMETERS.owner))
    names = selected_joints(own)
    chosen = PARAMETERS.select(own, names)
    if own["law"] in _OTHER_LAWS:
        return _OTHER_LAWS[own["law"]].configure(chosen, robot, dt)  # type: ignore[no-any-return]
    numbers = field_numbers(torque_adaptive.FIELDS, torque_adaptive.ALLOWED, chosen)
    for name in _SCALED:
        numbers[name] = own["adaptation_scale"] * np.asarray(chosen[name])
    for name in ("kinematic_cosine", "kinematic_sine"):
        numbers[name] = float(own["kinematic_feedforward"]) * numbers[name]
    return layout("TorqueParams", len(names)).pack(numbers)


def new_sample(joints: int) -> Block:
    """Empty TorqueSample block."""
    return layout("TorqueSample", joints).zeros()


def new_reference(joints: int) -> Block:
    """Empty TorqueReference block."""
    return layout("TorqueReference", joints).zeros()


def initial_state(params: Block, sample: Block | None = None) -> Block:
    """Estimates at their start values; the filters fill with the first sample and reference that `step` sees.

    Every law's state has a field `started`, 0 until then."""
    other = _LAW_OF_BLOCK.get(params.layout.name)
    if other is not None:
        return other.initial_state(params, sample)  # type: ignore[no-any-return]
    state = layout("TorqueState", params.joints).zeros()
    for name in ESTIMATES:
        state.view(name)[...] = params.view(f"{name}_initial")
    return state


def output_layout(params: Block) -> Layout:
    """Layout of the output of the law that a parameter block belongs to."""
    other = _LAW_OF_BLOCK.get(params.layout.name)
    name = params.layout.name.replace("Params", "Output")
    found: Layout = layout(name, params.joints) if other is None else other.layout(name, params.joints)
    return found


def restarted(state: Block) -> Block:
    """The state after a stop: estimates kept, filters filled anew with the next sample (bumpless restart)."""
    new = state.copy()
    new.started = 0.0
    return new


def step(params: Block, state: Block, sample: Block, reference: Block, dt: float) -> tuple[Block, Block]:
    """One sample. Returns (output, new state) of the law; the inputs stay as they were.

    A joint whose inputs are not finite gets a torque that is not finite (the gate stops on it) and keeps its state.
    """
    other = _LAW_OF_BLOCK.get(params.layout.name)
    if other is not None:
        return other.step(params, state, sample, reference, dt)  # type: ignore[no-any-return]
    joints = state.layout.joints
    output = layout("TorqueOutput", joints).zeros()
    new_state = Block(state.layout, np.empty(state.layout.size))
    _laws.torque_step(
        params.array, state.array, sample.array, reference.array, output.array, new_state.array, joints, dt
    )
    return output, new_state


__all__ = [
    "PARAMETERS",
    "configure",
    "initial_state",
    "layout",
    "new_reference",
    "new_sample",
    "restarted",
    "selected_joints",
    "step",
    "warnings",
]
