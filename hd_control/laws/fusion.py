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
from hd_control.core.parameters import JOINT_NAMES, Change, ParameterSet, field_numbers, parameters_of

MODEL_FIELDS = (
    *("torsional_stiffness", "gauge_gain", "gauge_offset", "gauge_temperature_drift"),
    *("gauge_cosine_2", "gauge_sine_2", "gauge_cosine_4", "gauge_sine_4", "kinematic_cosine", "kinematic_sine"),
)
"""Fields of the parameter block that are a model of drive and sensors: a live change ramps."""


def _turns_rule(values: Mapping[str, Any]) -> list[str]:
    return [
        f"gauge_joint_turns[{j}]: {turns:g} is not 0 (flexspline fixed to the casing), 1 or -1 (turns with the joint)"
        for j, turns in enumerate(values["gauge_joint_turns"])
        if turns not in (-1.0, 0.0, 1.0)
    ]


FIELDS, ALLOWED = _laws.BLOCKS["FusionParams"], _laws.ALLOWED["FusionParams"]
_MORE: Mapping[str, Mapping[str, Any]] = {name: {"change": Change.HOT} for name in MODEL_FIELDS} | {
    "derivative_cutoff": {"symbol": "ω", "source": "Zhu, section V"},
    "crossover": {"source": "chosen"},
    "gear_ratio": {"symbol": "N"},
    "torsional_stiffness": {"symbol": "k_f", "change": Change.HOT},
    "gauge_angle_offset": {"symbol": "β_0"},
    "kinematic_cosine": {"symbol": "a_n", "change": Change.HOT},
    "kinematic_sine": {"symbol": "b_n", "change": Change.HOT},
}
PARAMETERS = ParameterSet(
    "fusion law", (JOINT_NAMES, *parameters_of(FIELDS, ALLOWED, _MORE, live=_laws.LIVE["FusionParams"])), (_turns_rule,)
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
    return layout("FusionParams", joints).pack(field_numbers(FIELDS, ALLOWED, own))


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
