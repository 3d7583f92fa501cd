"""Controlled stop (action A2): decelerates on the motor side, then holds the place. Pure functions on blocks.

    v_r falls from the present velocity to 0 at stop_deceleration, x_r is its integral;
    u = hold_torque - stop_damping (v - v_r) - stop_stiffness (x - x_r)

`hold_torque` is the mean torque of the last 50 samples, so it carries the weight of the arm without any model. x and v
are motor position and velocity at the output side: feedback at the motor's own end of the spring cannot excite it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of

MEAN_SAMPLES = 50.0
SPEED_MARGIN = 0.3
"""rad/s; a joint that becomes faster than at the begin of the stop by more than this has left the stop. The filter of
the velocity lags by 5 ms, in which a wrong torque near the limit adds as much."""
_FIELDS = (
    ("elapsed", 0, "samples", "samples since the stop began"),
    ("hold_torque", 1, "N m", "mean torque before the stop"),
    ("reference_position", 1, "rad", "x_r"),
    ("reference_velocity", 1, "rad/s", "v_r"),
    ("first_speed", 1, "rad/s", "speed when the stop began"),
)


@lru_cache
def stop_layout(joints: int) -> Layout:
    """Layout of the memory of the stop."""
    return layout_of("StopState", _FIELDS, joints)


def initial_stop(joints: int) -> Block:
    """Nothing applied yet."""
    return stop_layout(joints).zeros()


def begin(mean_torque: FloatArray, position: FloatArray, velocity: FloatArray) -> Block:
    """The stop begins at motor position (n,) rad and velocity (n,) rad/s, which must be finite.

    `mean_torque` (n,) N m: mean of the torque that left before, over about `MEAN_SAMPLES`.
    """
    new = initial_stop(position.size)
    new.hold_torque = mean_torque
    new.reference_position, new.reference_velocity = position, velocity
    new.first_speed = np.abs(velocity)
    return new


def stop_torque(
    state: Block, position: FloatArray, velocity: FloatArray, limits: Block, dt: float
) -> tuple[FloatArray, Block]:
    """Torque (n,) N m of one sample of the stop, before any limit, and the new memory. `limits`: GuardLimits."""
    new = state.copy()
    new.elapsed = state.elapsed + 1.0
    before = state.reference_velocity
    new.reference_velocity = np.copysign(np.fmax(np.abs(before) - limits.stop_deceleration * dt, 0.0), before)
    new.reference_position = state.reference_position + new.reference_velocity * dt
    damping = limits.stop_damping * (velocity - new.reference_velocity)
    return state.hold_torque - damping - limits.stop_stiffness * (position - new.reference_position), new


def left(state: Block, velocity: FloatArray) -> int:
    """The first joint that moves faster than the stop allows, -1 if none does. A velocity that is NaN has left it."""
    slow = np.abs(velocity) <= state.first_speed + SPEED_MARGIN
    return -1 if bool(slow.all()) else int(np.argmin(slow))


def resting(state: Block) -> bool:
    """True once the reference stands: the state is HOLDING, before that STOPPING."""
    return not bool(np.any(state.reference_velocity))
