"""Types of the compiled module; built from hd_sim/cpp/single_joints_module.cpp."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

BLOCKS: dict[str, list[tuple[str, int, str, str]]]

class GearJoint:
    measured: _Array
    def __init__(self, params: list[float], gear_ratio: float) -> None: ...
    def advance(self, motor_torque: float, dt: float, steps: int) -> None: ...
    @property
    def wind_up(self) -> float: ...

class OneLinkArm:
    measured: _Array
    def __init__(self, params: list[float]) -> None: ...
    def advance(self, motor_torque: float, dt: float, steps: int) -> None: ...
