"""Torque-feedback law: the joint torque follows a required one with the gauge in the loop. Hashimoto (19).

Added to the paper's law, each switched off by 0: an integral term with a limit, and Coulomb friction fed forward in the
sense of the required torque's rate. `setpoint_kick` forms the rates of the required torque by difference; without it a
step of the required torque is not differentiated, and a smooth one is followed with more lag.
The law itself is hd_control/cpp/torque_feedback.hpp; docs/papers_hashimoto.md explains it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.laws import torque_adaptive
from hd_control.laws.integral_manifold import LINK_INERTIA

SHARED = ("joint_names", "torsional_stiffness", "rotor_inertia", "motor_torque_limit")
SECTION_4 = "Hashimoto, section IV"


def _joint(
    name: str, meaning: str, unit: str, symbol: str = "", source: str = "chosen", *, above: bool = False
) -> Parameter:
    return Parameter(
        name,
        meaning,
        unit,
        shape=Shape.PER_JOINT,
        low=0.0,
        open_low=above,
        symbol=symbol,
        source=source,
        change=Change.HOT,
    )


OWN = (
    Parameter("setpoint_kick", "rates of the required torque by difference", kind=bool, change=Change.HOT),
    Parameter(
        "torque_rate_cutoff",
        "cut-off of the filter on the joint torque's rate",
        "rad/s",
        low=0.0,
        open_low=True,
        high=1e5,
        source="chosen",
    ),
    _joint("feedback_proportional", "torque error to torque acceleration", "1/s^2", "K_p", SECTION_4),
    _joint("feedback_rate", "torque rate error to torque acceleration", "1/s", "K_d", SECTION_4),
    _joint("feedback_integral", "integral of the torque error; 0 in the paper", "1/s^3", "K_i"),
    _joint("feedback_integral_limit", "largest integral term", "N m"),
    _joint("feedback_friction", "Coulomb friction fed forward, output side", "N m"),
    _joint("feedback_friction_rate", "rate at which tanh feeds 76 % forward", "N m/s", above=True),
)


def _cutoff(values: Mapping[str, Any], dt: float) -> float:
    cutoff = float(values["torque_rate_cutoff"])
    if not cutoff < math.pi / dt:
        raise ConfigError(
            f"torque-feedback law: torque_rate_cutoff {cutoff:g} rad/s is not below {math.pi / dt:g} rad/s, "
            "half the sample rate"
        )
    return cutoff


PARAMETERS = ParameterSet(
    "torque-feedback law",
    (*(torque_adaptive.PARAMETERS[name] for name in SHARED), LINK_INERTIA, *OWN),
)
_NAMES = {
    "proportional_gain": "feedback_proportional",
    "rate_gain": "feedback_rate",
    "integral_gain": "feedback_integral",
    "integral_limit": "feedback_integral_limit",
    "friction_torque": "feedback_friction",
    "friction_rate": "feedback_friction_rate",
}


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of FeedbackParams, FeedbackReference, FeedbackState or FeedbackOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def configure(values: Mapping[str, Any], robot: object, dt: float) -> Block:
    """Parameter block. `robot` is not needed. Raises ConfigError with every problem."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    PARAMETERS.check(own, joints)
    numbers: dict[str, Any] = {name: own[name] for name in layout("FeedbackParams", 1).slices if name in own}
    numbers |= {field: own[name] for field, name in _NAMES.items()}
    numbers["setpoint_kick"] = float(own["setpoint_kick"])
    numbers["rate_pole"] = _laws.derivative_pole(_cutoff(own, dt), dt)
    return layout("FeedbackParams", joints).pack(numbers)


def new_sample(joints: int) -> Block:
    """Empty sample, the same as of the other torque laws; only the joint torque is used."""
    return layout_of("TorqueSample", _laws.BLOCKS["TorqueSample"], joints).zeros()


def new_reference(joints: int) -> Block:
    """Empty FeedbackReference: required torque with two derivatives."""
    return layout("FeedbackReference", joints).zeros()


def initial_state(params: Block, sample: Block | None = None) -> Block:
    """Nothing known yet: the rate filter fills with the first sample that `step` sees."""
    return layout("FeedbackState", params.joints).zeros()


def step(params: Block, state: Block, sample: Block, reference: Block, dt: float) -> tuple[Block, Block]:
    """One sample. Returns (FeedbackOutput, new FeedbackState); the inputs stay as they were.

    `reference` is a FeedbackReference, or the chain's TorqueReference, of which the required torque is used. A joint
    whose inputs are not finite gets a torque that is not finite and keeps its state.
    """
    output, new_state = layout("FeedbackOutput", params.joints).zeros(), state.copy()
    step_in_place(params, new_state, sample, reference, output, dt)
    return output, new_state


def step_in_place(params: Block, state: Block, sample: Block, reference: Block, output: Block, dt: float) -> None:
    """Like `step`, written into `state` and `output`: for simulations of many samples."""
    law = _laws.feedback_step if reference.layout.name == "FeedbackReference" else _laws.feedback_chain_step
    law(params.array, state.array, sample.array, reference.array, output.array, state.array, params.joints, dt)


def static_error(
    friction: float, stiffness: float, rotor_inertia: float, link_inertia: float, proportional: float
) -> float:
    """Steady torque error in N m that Coulomb friction (N m, output side) leaves without integral term. Hashimoto (20).

    Stiffness N m/rad, inertias kg m^2 at the output side (link 0: locked), proportional gain 1/s^2.
    """
    share = rotor_inertia / link_inertia if link_inertia > 0.0 else 0.0
    return friction / (rotor_inertia * proportional / stiffness + 1.0 + share)
