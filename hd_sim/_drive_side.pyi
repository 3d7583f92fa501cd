"""Types of the compiled module; built from hd_sim/cpp/drive_side_module.cpp. Arrays are views of its memory."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hd_control._chain import FaultTable, Guard, RowRing

_Array = NDArray[np.float64]

ARMING_SAMPLES: int

class DriveSide:
    guard: Guard
    faults: FaultTable
    ring: RowRing
    command: _Array
    applied: _Array
    incoming: _Array
    readings: _Array
    positions: _Array
    velocities: _Array
    true_position: _Array
    command_tick: NDArray[np.int64]
    rows: _Array
    refusals: _Array
    open: bool
    brake_closed: bool
    late: int
    stale: int
    ahead: int
    strangers: int
    stands: bool
    healthy: int
    state: int
    reset_asked: bool
    resets: int
    def __init__(
        self,
        world: Any,
        joints: int,
        state_size: int,
        period: float,
        gate_limits: _Array,
        guard_limits: _Array,
        bounds: _Array,
        gear_ratio: _Array,
        position_at: int,
        velocity_at: int,
        before: int,
        after: int,
    ) -> None: ...
    def offer(self, joints: list[int] | None, torque: _Array, tick: int) -> bool: ...
    def complete(self, tick: int) -> bool: ...
    def stranger(self) -> None: ...
    def latch(self, tick: int) -> None: ...
    def sample(self) -> None: ...
    def measure(self, tick: int) -> None: ...
    def advance(self) -> None: ...
    def reset(self, velocity: _Array) -> _Array: ...
    def measure_capsule(self) -> Any: ...
    def advance_capsule(self) -> Any: ...
    def advance_promptly_capsule(self) -> Any: ...
    def look_capsule(self) -> Any: ...
    def take_capsule(self) -> Any: ...
    def commands_capsule(self) -> Any: ...
