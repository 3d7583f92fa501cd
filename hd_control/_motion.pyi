"""Types of the compiled module; built from hd_control/cpp/motion_module.cpp."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

BLOCKS: dict[str, list[tuple[str, int, str, str]]]

def step(
    params: _Array,
    state: _Array,
    sample: _Array,
    reference: _Array,
    output: _Array,
    new_state: _Array,
    joints: int,
    dt: float,
) -> None: ...
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
