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
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_control.laws import torque_adaptive

COMPOSITIONS = ("comparison", "tau_0", "tau_1", "tau_2", "all")
LOAD_SOURCES = ("position", "required")
SHARED = (
    *("joint_names", "rate_source", "derivative_cutoff"),
    *("gear_ratio", "torsional_stiffness", "rotor_inertia", "motor_torque_limit"),
)
HYSTERESIS_SOURCES = ("measured", "wanted")
KINEMATIC = tuple(
    f"kinematic_{kind}_{n}" for kind in ("cosine", "sine") for n in range(1, torque_adaptive.HARMONICS + 1)
)
TABLE, SECTION_5 = "Gandhi, Table I", "Gandhi, section V"


def _joint(
    name: str,
    meaning: str,
    unit: str,
    symbol: str,
    source: str,
    low: float = 0.0,
    *,
    above: bool = False,
    change: Change = Change.INACTIVE,
) -> Parameter:
    return Parameter(
        name, meaning, unit, shape=Shape.PER_JOINT, low=low, open_low=above, symbol=symbol, source=source, change=change
    )


LINK_INERTIA = _joint("link_inertia", "inertia of the link; 0: the link is locked", "kg m^2", "J_l", TABLE)
OWN = (
    Parameter(
        "composition", "terms of the integral-manifold law", kind=str, choices=COMPOSITIONS, change=Change.INACTIVE
    ),
    Parameter("prediction_samples", "from the measurement to the middle of the command's hold", low=0.0, high=4.5),
    Parameter(
        "load_source", "load: function of the wanted position, or required torque", kind=str, choices=LOAD_SOURCES
    ),
    Parameter(
        "hysteresis_source",
        "hysteresis torque from the measured torsion (fine sensors), or from the wanted torque",
        kind=str,
        choices=HYSTERESIS_SOURCES,
    ),
    LINK_INERTIA,
    _joint("stiffness_cubic", "cubic part of the spring; 0 in the law of the paper", "N m/rad^3", "m_2", "chosen"),
    _joint("stiffness_quintic", "quintic part of the spring", "N m/rad^5", "m_3", "chosen"),
    _joint(
        "rotor_coulomb",
        "Coulomb friction of the rotor, fed forward; 0 in the paper",
        "N m",
        "",
        "chosen",
        change=Change.HOT,
    ),
    _joint("friction_speed", "wanted speed at which tanh feeds 76 % of it forward", "rad/s", "", "chosen", above=True),
    _joint("rotor_damping", "viscous damping of the rotor, output side", "N m s", "N² B_m", TABLE, change=Change.HOT),
    _joint("link_damping", "viscous damping of the link", "N m s", "B_l", TABLE),
    _joint("hysteresis_stiffness", "slope of the hysteresis torque after a reversal", "N m/rad", "A", TABLE),
    _joint("hysteresis_rate", "how fast it saturates, at A/α", "1/rad", "α", TABLE),
    _joint("perturbation_stiffness", "scale of the fast variable", "N m/rad", "K_1", "chosen", above=True),
    _joint("tracking_gain", "position error to velocity", "1/s", "Λ", "chosen"),
    _joint("tracking_damping", "velocity error to torque", "N m s", "k_d", "chosen"),
    _joint("fast_damping_ratio", "damping ratio of the fast mode", "-", "ζ", "chosen", above=True),
    _joint("load_constant", "known load: constant part", "N m", "", SECTION_5, -math.inf),
    _joint("load_cosine", "known load: with cos q_d", "N m", "", SECTION_5, -math.inf),
    _joint("load_sine", "known load: with sin q_d", "N m", "", SECTION_5, -math.inf),
)


def _link_rule(values: Mapping[str, Any]) -> list[str]:
    return [
        f"{joint}: the integral-manifold law needs link_inertia above 0"
        for joint, inertia in zip(values["joint_names"], values["link_inertia"], strict=True)
        if not inertia > 0.0
    ]


PARAMETERS = ParameterSet(
    "integral-manifold law",
    (*(torque_adaptive.PARAMETERS[name] for name in (*SHARED, *KINEMATIC)), *OWN),
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
    numbers: dict[str, Any] = {name: own[name] for name in layout("ManifoldParams", 1).slices if name in own}
    numbers["composition"] = COMPOSITIONS.index(own["composition"])
    numbers["load_source"] = LOAD_SOURCES.index(own["load_source"])
    numbers["hysteresis_source"] = HYSTERESIS_SOURCES.index(own["hysteresis_source"])
    numbers["error_filter"] = float(own["rate_source"] == "error_filter")
    numbers["derivative_pole"] = _laws.derivative_pole(own["derivative_cutoff"], dt)
    numbers["position_gain"], numbers["damping_gain"] = own["tracking_gain"], own["tracking_damping"]
    numbers["fast_gain"] = [
        fast_gain(*row)
        for row in zip(
            *(own[name] for name in ("gear_ratio", "torsional_stiffness", "rotor_inertia", "link_inertia")),
            own["perturbation_stiffness"],
            own["fast_damping_ratio"],
            strict=True,
        )
    ]
    for kind in ("cosine", "sine"):
        rows: Sequence[Any] = [own[f"kinematic_{kind}_{n}"] for n in range(1, torque_adaptive.HARMONICS + 1)]
        numbers[f"kinematic_{kind}"] = np.array(rows).T
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
