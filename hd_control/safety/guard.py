"""Guard: the safety gate with a controlled stop in front of it. The same object stands on both sides of the wire.

    command -> inputs healthy? -> envelope -> strongest action -> law's torque | stop torque | ramp -> safety gate

Actions (docs/safety.md): a fault of action CONTROLLED_STOP decelerates and holds (A2); without a usable motor position,
or when the stop is left, and for TORQUE_RAMP, the gate ramps the torque to zero and the brake is requested (A3). The
drive side holds only while its brakes close. Both latch for all joints; only `reset` ends them.

The rules are compiled, once (`cpp/guard.hpp`): no clock, no allocation, no exception for any number. Here are
their blocks, modes and words. This is not a certified safety function.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _chain
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Fault
from hd_control.safety.gate import faults_of, rows_of, state_layout
from hd_control.safety.limits import SafetyLimits


class Mode(enum.IntEnum):
    """What leaves: nothing, the law's torque, the torque of a controlled stop, or the ramp to zero."""

    INACTIVE = 0
    ACTIVE = 1
    STOPPING = 2
    HOLDING = 3
    STOPPED = 4


@lru_cache
def layout(block: str, joints: int) -> Layout:
    """Layout of GuardState, StopState or GuardMeasured."""
    return layout_of(block, _chain.BLOCKS[block], joints)


def envelope(low: FloatArray, high: FloatArray, speed: FloatArray) -> FloatArray:
    """Limits of the joints as the guard takes them, (3 n,): position low and high rad, velocity limit rad/s."""
    return np.concatenate([low, high, speed]).astype(float)


class Guard:
    """State and step of one side. `low`, `high` (n,) rad and `speed` (n,) rad/s: limits of the joints of the robot.

    `hold_samples` 0: a controlled stop holds without end. `native`: a guard that stands inside a stage or a drive side.
    """

    def __init__(
        self,
        limits: SafetyLimits,
        low: FloatArray,
        high: FloatArray,
        speed: FloatArray,
        dt: float,
        hold_samples: int = 0,
        native: Any = None,
    ) -> None:
        n = limits.joints
        self.limits, self.low, self.high, self.dt, self.hold_samples = limits, low, high, dt, hold_samples
        bounds = envelope(low, high, speed)
        self.native = native or _chain.Guard(limits.gate.array, limits.guard.array, bounds, n, dt, float(hold_samples))
        self.gate = Block(state_layout(n), self.native.gate)
        self.stop = Block(layout("StopState", n), self.native.stop)
        self.measured = Block(layout("GuardMeasured", n), self.native.measured)
        self.state = Block(layout("GuardState", n), self.native.state)

    @property
    def mode(self) -> Mode:
        """The state as the safety notes name it."""
        return Mode(self.native.mode)

    @property
    def stopped(self) -> bool:
        """True after a latched stop of either kind."""
        return bool(self.native.stopped)

    @property
    def controlled(self) -> bool:
        """True while a controlled stop runs or holds."""
        return bool(self.state.controlled != 0.0)

    @property
    def healthy(self) -> int:
        """Samples in a row without a fault that stops."""
        return int(self.state.healthy)

    @property
    def last_tick(self) -> FloatArray:
        """Ticks (n,) of the last commands looked at."""
        return self.state.last_tick

    def activate(self, applied: FloatArray) -> None:
        """Opens with the torque (n,) N m that the drive holds now. A latched stop stays latched."""
        self.native.activate(np.asarray(applied, dtype=float))

    def deactivate(self) -> None:
        """Closed: zero torque from the next sample. A controlled stop ends as a ramp that has ended."""
        self.native.deactivate()

    def step(
        self, command: FloatArray, ages: FloatArray, ticks: FloatArray, demands: Sequence[Fault] = ()
    ) -> tuple[FloatArray, list[Fault]]:
        """One sample: the torque that may leave (n,) N m, and its faults. `demands` are those of the monitors."""
        out, rows = self.native.step(command, ages, ticks, rows_of(demands) if demands else None)
        return out, faults_of(rows)

    def reset(self, reasons: Sequence[str] = ()) -> list[str]:
        """Ends a latched stop if all is healthy, still and none of the caller's `reasons` speaks against it.

        Returns the reasons of a refusal; none if there is nothing to end.
        """
        if not self.stopped:
            return []
        return [*refusals(self.native.reset(bool(reasons))), *reasons]


def refusals(rows: FloatArray, joint_names: Sequence[str] = ()) -> list[str]:
    """Reasons (k, 4) of a refused reset in words: kind, joint, value, limit."""
    return [_refusal(int(kind), int(joint), value, limit, joint_names) for kind, joint, value, limit in rows.tolist()]


def _refusal(kind: int, joint: int, value: float, limit: float, joint_names: Sequence[str]) -> str:
    name = joint_names[joint] if 0 <= joint < len(joint_names) else f"joint_{joint + 1}"
    return {
        1: f"inputs healthy for {value:g} samples, {limit:g} needed; wait or repair them",
        2: f"joint_{joint + 1} moves with {value:.4g} rad/s, limit {limit:g} rad/s; wait for rest",
        3: f"joint_{joint + 1} torque ramp runs at {value:.4g} N m; wait for zero",
        4: f"{name}: a goal is active; reset the motion law first",
        5: f"{name}: reference {value:.4g} rad from the joint, limit {limit:g} rad; reset the motion law first",
    }[kind]
