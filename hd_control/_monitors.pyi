"""Types of the compiled module; built from hd_control/cpp/monitors_module.cpp."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

def all_finite(values: _Array) -> bool: ...
def all_below(values: _Array, limit: _Array) -> bool: ...
def all_near(a: _Array, b: _Array, limit: _Array) -> bool: ...
def readings_follow(
    reading: _Array, last: _Array, slope: _Array, limit: _Array, period: _Array | None
) -> tuple[bool, _Array]: ...
def sum_turn(
    residual: _Array,
    shaft: _Array,
    gauge_angle: _Array,
    last_shaft: _Array,
    terms: _Array,
    sums: _Array,
    travel: _Array,
    whole: float,
    longest_way: float,
    largest_step: float,
) -> tuple[bool, _Array, _Array, _Array]: ...
def missed_motion(
    positions: _Array,
    twist: _Array,
    reading: _Array,
    repeats: _Array,
    expected: _Array,
    other: _Array,
    samples: float,
    limit: _Array,
    step: float,
) -> tuple[bool, _Array, _Array, _Array, _Array]: ...
def gauge_changes(
    gauge: _Array,
    position: _Array,
    reading: _Array,
    repeats: _Array,
    start: _Array,
    limit: _Array,
    samples: float,
) -> tuple[bool, _Array, _Array]: ...
def guard_is_quiet(
    command: _Array,
    ages: _Array,
    ticks: _Array,
    last_tick: _Array,
    position: _Array,
    velocity: _Array,
    low: _Array,
    high: _Array,
    speed: _Array,
    twice_deceleration: _Array,
    age_limit: float,
    largest_tick: float,
) -> bool: ...
