"""Fusion law: encoder, resolver and gauge bridge become one state estimate, output side of the gear.

`joint_position_source` says where the joint position comes from:

- `resolver`: the joint sensor alone, as in Zhu.
- `complementary`: below `crossover` the joint sensor, above it motor position + KE - torque / stiffness. In motion it
  resolves less than one count of the joint sensor. Without a kinematic-error map the gear error goes into the result.

The law itself is hd_control/cpp/fusion.hpp; docs/equations/fusion.md explains it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _laws
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape

HARMONICS = 4
SOURCES = ("resolver", "complementary")
MODEL_FIELDS = (
    *("torsional_stiffness", "gauge_gain", "gauge_offset", "gauge_temperature_drift"),
    *("gauge_cosine_2", "gauge_sine_2", "gauge_cosine_4", "gauge_sine_4", "kinematic_cosine", "kinematic_sine"),
)
"""Fields of the parameter block that are a model of drive and sensors: a live change ramps."""


def _joint(
    name: str,
    meaning: str,
    unit: str,
    symbol: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    *,
    above: bool = False,
    change: Change = Change.INACTIVE,
) -> Parameter:
    return Parameter(
        name, meaning, unit, shape=Shape.PER_JOINT, low=low, high=high, open_low=above, symbol=symbol, change=change
    )


def _model(
    name: str, meaning: str, unit: str, symbol: str = "", low: float = -math.inf, high: float = math.inf
) -> Parameter:
    return _joint(name, meaning, unit, symbol, low, high, change=Change.HOT)


def _turns_rule(values: Mapping[str, Any]) -> list[str]:
    return [
        f"gauge_joint_turns[{j}]: {turns:g} is not 0 (flexspline fixed to the casing), 1 or -1 (turns with the joint)"
        for j, turns in enumerate(values["gauge_joint_turns"])
        if turns not in (-1.0, 0.0, 1.0)
    ]


PARAMETERS = ParameterSet(
    "fusion law",
    (
        Parameter("joint_names", "joints, in the order of every list", kind=str, shape=Shape.LIST, change=Change.FIXED),
        Parameter(
            "joint_position_source", "joint sensor, or motor side above the crossover", kind=str, choices=SOURCES
        ),
        Parameter(
            "derivative_cutoff",
            "cut-off of the derivative filter D",
            "rad/s",
            low=0.0,
            open_low=True,
            high=1e5,
            symbol="ω",
            source="Zhu, section V",
        ),  # fmt: skip
        Parameter(
            "crossover",
            "where the joint sensor hands over to the motor side",
            "rad/s",
            low=0.0,
            open_low=True,
            high=1e4,
            source="chosen",
        ),  # fmt: skip
        _joint("gear_ratio", "rotor turns per joint turn", "-", "N", 0.0, above=True),
        _joint("torsional_stiffness", "linear stiffness", "N m/rad", "k_f", 0.0, above=True, change=Change.HOT),
        _joint("encoder_period", "rotor angle at which the encoder wraps; 0: multi-turn", "rad", low=0.0),
        _joint("resolver_period", "joint angle at which the resolver wraps; 0: multi-turn", "rad", low=0.0),
        _joint("encoder_offset", "rotor angle read at zero", "rad"),
        _joint("resolver_offset", "joint angle read at zero", "rad"),
        _model("gauge_gain", "indicated torque per true torque", "-", "", 0.1, 10.0),
        _model("gauge_offset", "indicated torque at zero torque", "N m"),
        _model("gauge_temperature_drift", "change of the offset with temperature", "N m/K"),
        _joint("gauge_reference_temperature", "temperature at which gauge_offset holds", "degC", "", -100.0, 300.0),
        _joint("gauge_angle_offset", "gauge angle at zero rotor angle", "rad", "β_0"),
        _joint("gauge_joint_turns", "turns of the gauge per joint turn", "-", "", -1.0, 1.0),
        _model("gauge_cosine_2", "ripple with cos 2β", "N m"),
        _model("gauge_sine_2", "ripple with sin 2β", "N m"),
        _model("gauge_cosine_4", "ripple with cos 4β", "N m"),
        _model("gauge_sine_4", "ripple with sin 4β", "N m"),
        *(
            _model(
                f"kinematic_{kind}_{n}", f"kinematic error, {kind} of {n} theta_m", "rad", f"{letter}_{n}", -0.1, 0.1
            )
            for kind, letter in (("cosine", "a"), ("sine", "b"))
            for n in range(1, HARMONICS + 1)
        ),
    ),
    (_turns_rule,),
)


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of FusionParams, FusionSample, FusionState or FusionOutput."""
    return layout_of(block, _laws.BLOCKS[block], joints)


def configure(values: Mapping[str, Any], robot: object, dt: float) -> Block:
    """Checked values as a parameter block. `robot` is not needed. Raises ConfigError with every problem."""
    own = {name: values[name] for name in PARAMETERS.names if name in values}
    joints = len(own.get("joint_names", ()))
    PARAMETERS.check(own, joints)
    if not own["derivative_cutoff"] < math.pi / dt:
        raise ConfigError(
            f"{PARAMETERS.owner}: derivative_cutoff {own['derivative_cutoff']:g} rad/s is not below "
            f"{math.pi / dt:g} rad/s, half the sample rate"
        )
    block = layout("FusionParams", joints)
    numbers: dict[str, Any] = {name: own[name] for name in block.slices if name in own}
    numbers["joint_position_source"] = SOURCES.index(own["joint_position_source"])
    numbers["derivative_pole"] = _laws.derivative_pole(own["derivative_cutoff"], dt)
    numbers["crossover_weight"] = -math.expm1(-own["crossover"] * dt)
    for kind in ("cosine", "sine"):
        numbers[f"kinematic_{kind}"] = np.array([own[f"kinematic_{kind}_{n}"] for n in range(1, HARMONICS + 1)]).T
    return block.pack(numbers)


def new_sample(joints: int) -> Block:
    """Empty FusionSample block; the temperature is unknown (not a number) until one is written."""
    sample = layout("FusionSample", joints).zeros()
    sample.motor_temperature = math.nan
    return sample


def initial_state(params: Block, sample: Block | None = None) -> Block:
    """Nothing known yet: the filters fill with the first sample that `step` sees."""
    return layout("FusionState", params.joints).zeros()


def step(params: Block, state: Block, sample: Block, dt: float) -> tuple[Block, Block]:
    """One sample. Returns (FusionOutput, new FusionState); the inputs stay as they were.

    A reading that is not finite shows in the output as not finite and leaves the filters as they were.
    """
    joints = state.layout.joints
    output = layout("FusionOutput", joints).zeros()
    new_state = Block(state.layout, np.empty(state.layout.size))
    _laws.fusion_step(params.array, state.array, sample.array, output.array, new_state.array, joints, dt)
    return output, new_state
