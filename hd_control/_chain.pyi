"""Types of the compiled module; built from hd_control/cpp/chain_module.cpp. Blocks are writable views of its memory."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

BLOCKS: dict[str, list[tuple[str, int, str, str]]]
"""Block -> its fields: name, numbers per joint (0: one for all), unit, meaning."""
CODES: int
WARM_TICKS: int
STOPS: int

class Guard:
    gate: _Array
    state: _Array
    stop: _Array
    measured: _Array
    mode: int
    stopped: bool
    def __init__(
        self, gate_limits: _Array, guard_limits: _Array, bounds: _Array, joints: int, dt: float, hold_samples: float
    ) -> None: ...
    def activate(self, applied: _Array) -> None: ...
    def deactivate(self) -> None: ...
    def look(self) -> None: ...
    def step(
        self, command: _Array, ages: _Array, ticks: _Array, demands: _Array | None = None
    ) -> tuple[_Array, _Array]: ...
    def reset(self, others: bool = False) -> _Array: ...

class FaultTable:
    joints: int
    stop_tick: float
    entries: _Array
    stop: _Array
    def __init__(self, joints: int) -> None: ...
    def note(self, rows: _Array, tick: float) -> None: ...
    def clear(self) -> None: ...
    def take_over(self, other: FaultTable) -> None: ...

class RowRing:
    rows: int
    width: int
    written: int
    stops: int
    stop_rows: _Array
    causes: _Array
    data: _Array
    def __init__(self, rows: int) -> None: ...
    def watch(self, numbers: _Array) -> None: ...
    def note(self, tick: float, cause: _Array | None) -> None: ...

class _Tick:
    tick: int
    has_state: bool
    params: _Array
    ramping: bool
    sample: _Array
    output: _Array
    state: _Array
    def offer(self, block: _Array) -> None: ...
    def arrive(self) -> None: ...
    def start(self) -> None: ...
    def act(self, now: int) -> None: ...
    def step_capsule(self) -> Any: ...

class FusionTick(_Tick):
    raw: _Array
    residual_mean: _Array
    residual_ripple: _Array
    missed_motion: _Array
    compared: bool
    rows: _Array
    faults: FaultTable
    def __init__(self, joints: int, dt: float, guard_limits: _Array, kinds: list[int]) -> None: ...

class MotionPath:
    id: int
    def __init__(
        self, id: int, start: int, period: float, knots: _Array, coefficients: _Array, end: _Array
    ) -> None: ...

class MotionTick(_Tick):
    reference: _Array
    mode: int
    reset_asked: bool
    resets: int
    late_goals: int
    aborted_goals: int
    rate: float
    lag: float
    handed_over: int | None
    active: tuple[int, int, _Array, _Array] | None
    pending: tuple[int, int, _Array, _Array] | None
    def __init__(self, joints: int, dt: float, kinds: list[int]) -> None: ...
    def hand_over(self, path: MotionPath) -> None: ...
    def moving(self, tick: float) -> bool: ...

class TorqueTick(_Tick):
    reference: _Array
    adaptation: _Array
    allowed: _Array
    input_ticks: _Array
    guard: Guard
    faults: FaultTable
    ring: RowRing
    rows: _Array
    mode: int
    gate_open: bool
    degraded_samples: float
    lost: float
    warm: int
    railed: _Array
    disobeyed: _Array
    compares_applied: bool
    idle: float
    failed: bool
    reset_asked: bool
    resets: int
    refusals: _Array
    def __init__(
        self,
        joints: int,
        dt: float,
        law: int,
        gate_limits: _Array,
        guard_limits: _Array,
        bounds: _Array,
        before: int,
        after: int,
        kinds: list[int],
        starts: list[tuple[int, int]],
        unseen_inputs: list[float],
    ) -> None: ...
    def act_with(self, now: int, command: _Array | None) -> None: ...
    def mode_capsule(self) -> Any: ...

class StopFlag:
    value: _Array
    def __init__(self, guards: list[Guard]) -> None: ...
    def step_capsule(self) -> Any: ...

class ModeLink:
    def __init__(self, torque: TorqueTick, motion: MotionTick) -> None: ...
    def step_capsule(self) -> Any: ...

class Sequence:
    def __init__(self) -> None: ...
    def copy(self, source: _Array, target: _Array) -> None: ...
    def stamp(self, ticks: _Array) -> None: ...
    def call(self, step: Any) -> None: ...
    def record(self, numbers: _Array, table: _Array) -> None: ...
    def every(self, ticks: int) -> None: ...
    def run(self, first: int, count: int, stop: _Array | None = None) -> int: ...
    def step_capsule(self) -> Any: ...
