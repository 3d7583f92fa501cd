"""Integral-manifold law: position of one joint with known smooth load, kinematic error and hysteresis compensated.

Gandhi and Ghorbel, corrected. `composition` says how much of it acts:

- `all`: the composite controller (26)-(30), a fast term and the slow terms tau_0, tau_1, tau_2, tau_4.
- `tau_2`, `tau_1`, `tau_0`: the slow terms up to that one, for ablation.
- `comparison`: the controller (31) that knows neither kinematic error nor hysteresis; the load is used once.

`prediction_samples` moves the measurement to the middle of the hold of the command with the law's model: 0.5 without
delay, 1.5 with one sample of delay, 0 switches it off. Joints do not know of each other: it is a law for one joint, or
for joints whose coupling is small. The law itself is hd_control/cpp/integral_manifold.hpp; docs/papers_gandhi.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.parameters import (
    JOINT_NAMES,
    Change,
    Parameter,
    ParameterSet,
    Shape,
    field_numbers,
    parameters_of,
)
from hd_control.laws import torque_adaptive

FIELDS, ALLOWED = _laws.BLOCKS["ManifoldParams"], _laws.ALLOWED["ManifoldParams"]
COMPOSITIONS = ALLOWED["composition"][4]
TABLE, SECTION_5 = "Gandhi, Table I", "Gandhi, section V"
_MORE: Mapping[str, Mapping[str, Any]] = {
    **{name: {"source": ""} for name in ("composition", "prediction_samples", "load_source", "hysteresis_source")},
    "link_inertia": {"symbol": "J_l", "source": TABLE},
    "stiffness_cubic": {"symbol": "m_2"},
    "stiffness_quintic": {"symbol": "m_3"},
    "rotor_coulomb": {"change": Change.HOT},
    "rotor_damping": {"symbol": "N² B_m", "source": TABLE, "change": Change.HOT},
    "link_damping": {"symbol": "B_l", "source": TABLE},
    "hysteresis_stiffness": {"symbol": "A", "source": TABLE},
    "hysteresis_rate": {"symbol": "α", "source": TABLE},
    "perturbation_stiffness": {"symbol": "K_1"},
    "tracking_gain": {"symbol": "Λ"},
    "tracking_damping": {"symbol": "k_d"},
    **{f"load_{part}": {"source": SECTION_5} for part in ("constant", "cosine", "sine")},
}
_READ = (
    *parameters_of(FIELDS, ALLOWED, _MORE, ("fast_gain",), _laws.LIVE["ManifoldParams"], source="chosen"),
    Parameter(  # gives fast_gain
        "fast_damping_ratio",
        "damping ratio of the fast mode",
        shape=Shape.PER_JOINT,
        low=0.0,
        open_low=True,
        symbol="ζ",
        source="chosen",
    ),
)
_ADAPTIVE = torque_adaptive.PARAMETERS
OWN = tuple(parameter for parameter in _READ if parameter.name not in _ADAPTIVE.names)
"""What the adaptive torque law does not have; the others are the same parameters of the node."""


def _link_rule(values: Mapping[str, Any]) -> list[str]:
    return [
        f"{joint}: the integral-manifold law needs link_inertia above 0"
        for joint, inertia in zip(values["joint_names"], values["link_inertia"], strict=True)
        if not inertia > 0.0
    ]


PARAMETERS = ParameterSet(
    "integral-manifold law",
    (JOINT_NAMES, *(_ADAPTIVE[p.name] for p in _READ if p.name in _ADAPTIVE.names), *OWN),
    (_link_rule,),
)


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of ManifoldParams, ManifoldReference, ManifoldState or ManifoldOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def fast_gain(
    ratio: float, stiffness: float, rotor_inertia: float, link_inertia: float, scale: float, damping_ratio: float
) -> float:
    """K_D in s that gives the fast mode its damping ratio at Y_p = 1/N: 2 zeta omega_n epsilon / C_1.

    `ratio` N; stiffness K and `scale` K_1 N m/rad; inertias kg m^2, the rotor's at the output side.
    """
    rotor, slope = rotor_inertia / ratio**2, 1.0 / ratio
    weight = scale * slope / rotor
    epsilon = math.sqrt(scale / stiffness)
    frequency = math.sqrt(weight * (rotor / (slope * link_inertia) + slope)) / epsilon
    return 2.0 * damping_ratio * frequency * epsilon / weight


def configure(values: Mapping[str, Any], robot: object, dt: float) -> Block:
    """Parameter block. `robot` is not needed. Raises ConfigError with every problem."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    PARAMETERS.check(own, joints)
    numbers = field_numbers(FIELDS, ALLOWED, own)
    numbers["fast_gain"] = [
        fast_gain(*row)
        for row in zip(
            *(own[name] for name in ("gear_ratio", "torsional_stiffness", "rotor_inertia", "link_inertia")),
            own["perturbation_stiffness"],
            own["fast_damping_ratio"],
            strict=True,
        )
    ]
    return layout("ManifoldParams", joints).pack(numbers)


def new_sample(joints: int) -> Block:
    """Empty sample, the same as of the other torque laws."""
    return layout_of("TorqueSample", _laws.BLOCKS["TorqueSample"], joints).zeros()


def new_reference(joints: int) -> Block:
    """Empty ManifoldReference: wanted position with four derivatives, load with two."""
    return layout("ManifoldReference", joints).zeros()


def initial_state(params: Block, sample: Block | None = None) -> Block:
    """Nothing known yet. The first sample's joint torque gives the hysteresis torque."""
    return layout("ManifoldState", params.joints).zeros()


def step(params: Block, state: Block, sample: Block, reference: Block, dt: float) -> tuple[Block, Block]:
    """One sample. Returns (ManifoldOutput, new ManifoldState); the inputs stay as they were.

    `reference` is a ManifoldReference, or the chain's TorqueReference, whose derivatives are then differences of the
    samples before. A joint whose inputs are not finite gets a torque that is not finite and keeps its state.
    """
    output, new_state = layout("ManifoldOutput", params.joints).zeros(), state.copy()
    step_in_place(params, new_state, sample, reference, output, dt)
    return output, new_state


def step_in_place(params: Block, state: Block, sample: Block, reference: Block, output: Block, dt: float) -> None:
    """Like `step`, written into `state` and `output`: for simulations of many samples."""
    law = _laws.manifold_step if reference.layout.name == "ManifoldReference" else _laws.manifold_chain_step
    law(params.array, state.array, sample.array, reference.array, output.array, state.array, params.joints, dt)
