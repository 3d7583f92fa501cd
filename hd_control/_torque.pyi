"""Types of the compiled module; built from hd_control/cpp/torque_module.cpp."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

BLOCKS: dict[str, list[tuple[str, int, str, str]]]
FAULT_FIELDS: int
FAULTS_PER_JOINT: int

def fusion_step(
    params: _Array, state: _Array, sample: _Array, output: _Array, new_state: _Array, joints: int, dt: float
) -> None: ...
def torque_step(
    params: _Array,
    state: _Array,
    sample: _Array,
    reference: _Array,
    output: _Array,
    new_state: _Array,
    joints: int,
    dt: float,
) -> None: ...
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
def derivative_pole(cutoff: float, dt: float) -> float: ...
def project(value: float, drive: float, gain: float, low: float, high: float, dt: float) -> float: ...
