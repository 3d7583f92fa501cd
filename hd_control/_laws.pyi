"""Types of the compiled module; built from hd_control/cpp/laws_module.cpp."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

class _Step(Protocol):
    def __call__(
        self,
        params: _Array,
        state: _Array,
        sample: _Array,
        reference: _Array,
        output: _Array,
        new_state: _Array,
        joints: int,
        dt: float,
    ) -> None: ...

BLOCKS: dict[str, list[tuple[str, int, str, str]]]
"""Block -> its fields: name, numbers per joint (0: one for all), unit, meaning."""
ALLOWED: dict[str, dict[str, tuple[str, float, float, bool, tuple[str, ...]]]]
LIVE: dict[str, dict[str, tuple[float, float]]]
"""Block of parameters -> field -> what it may hold: kind, lowest, highest, whether the lowest is excluded, words."""
FAULT_FIELDS: int
FAULTS_PER_JOINT: int

def fusion_step(
    params: _Array, state: _Array, sample: _Array, output: _Array, new_state: _Array, joints: int, dt: float
) -> None: ...

motion_step: _Step
torque_step: _Step
manifold_step: _Step
manifold_chain_step: _Step
feedback_step: _Step
feedback_chain_step: _Step

def derivative_pole(cutoff: float, dt: float) -> float: ...
def project(value: float, drive: float, gain: float, low: float, high: float, dt: float) -> float: ...
def batch_torque(
    joints: int,
    rotation: _Array,
    origin: _Array,
    gravity: float,
    link_parameters: _Array,
    position: _Array,
    velocity: _Array,
    required_velocity: _Array,
    acceleration: _Array,
) -> _Array: ...
def parameter_drive(
    joints: int,
    params: _Array,
    position: _Array,
    velocity: _Array,
    required_velocity: _Array,
    acceleration: _Array,
) -> _Array: ...
def spline_coefficients(
    order: int, knots: _Array, dt: float, q: _Array, v: _Array, a: _Array, joints: int
) -> _Array: ...
def spline_evaluate(
    knots: _Array, coefficients: _Array, tick: float, dt: float, cursor: int, out: _Array, joints: int
) -> int: ...
def spline_extrema(knots: _Array, coefficients: _Array, dt: float, joints: int) -> _Array: ...
def gate_step(
    command: _Array,
    ages: _Array,
    ticks: _Array,
    limits: _Array,
    state: _Array,
    output: _Array,
    new_state: _Array,
    fault_rows: _Array,
    joints: int,
) -> int: ...
