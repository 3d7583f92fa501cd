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
from hd_control.core.parameters import JOINT_NAMES, Change, ParameterSet, field_numbers, parameters_of
from hd_control.laws import integral_manifold, torque_adaptive

FIELDS, ALLOWED = _laws.BLOCKS["FeedbackParams"], _laws.ALLOWED["FeedbackParams"]
SECTION_4 = "Hashimoto, section IV"
_MORE: Mapping[str, Mapping[str, Any]] = {
    "setpoint_kick": {"source": ""},
    "torque_rate_cutoff": {"change": Change.INACTIVE},
    "feedback_proportional": {"symbol": "K_p", "source": SECTION_4},
    "feedback_rate": {"symbol": "K_d", "source": SECTION_4},
    "feedback_integral": {"symbol": "K_i"},
}
_READ = parameters_of(FIELDS, ALLOWED, _MORE, live=_laws.LIVE["FeedbackParams"], source="chosen", change=Change.HOT)
_OTHERS = {p.name: p for p in (*torque_adaptive.PARAMETERS.parameters, *integral_manifold.OWN)}
OWN = tuple(parameter for parameter in _READ if parameter.name not in _OTHERS)
"""What no other torque law has; the others are the same parameters of the node."""


def _check_cutoff(values: Mapping[str, Any], dt: float) -> None:
    cutoff = float(values["torque_rate_cutoff"])
    if not cutoff < math.pi / dt:
        raise ConfigError(
            f"torque-feedback law: torque_rate_cutoff {cutoff:g} rad/s is not below {math.pi / dt:g} rad/s, "
            "half the sample rate"
        )


PARAMETERS = ParameterSet(
    "torque-feedback law", (JOINT_NAMES, *(_OTHERS[p.name] for p in _READ if p.name in _OTHERS), *OWN)
)


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of FeedbackParams, FeedbackReference, FeedbackState or FeedbackOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def configure(values: Mapping[str, Any], robot: object, dt: float) -> Block:
    """Parameter block. `robot` is not needed. Raises ConfigError with every problem."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    PARAMETERS.check(own, joints)
    _check_cutoff(own, dt)
    return layout("FeedbackParams", joints).pack(field_numbers(FIELDS, ALLOWED, own))


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
