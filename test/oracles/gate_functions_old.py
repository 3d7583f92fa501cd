"""Safety gate: the last layer before the motor command. It does not trust the controller.

One pure function, `safety_gate`. No clock, no file, no randomness, no exception for any number. Order of the checks:
finite -> tick and age -> active and latch -> size -> rate (against the torque that last left the gate).

- A compliant command leaves bit for bit as it came. Not active: exactly zero torque.
- Too large or too fast: limited, counted, reported. Too fast many times in a row: stop.
- Not finite, too old, or a tick that is not above the last one used: stop.
- A stop latches for all joints of the block: torque ramps to zero at the rate limit without changing sign, and the
  brake is requested. Only `reset` ends it.

Comparisons are written so that a NaN fails them. The arithmetic of a sample is compiled (`SafetyGate` in
`cpp/safety.hpp`); the tests hold it against a plain re-statement, bit for bit. Activation and reset are here.
This is not a certified safety function: a real arm needs a hardware emergency stop and brakes of its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Action, Fault, FaultCode

LARGEST_TICK = 2.0**53


@lru_cache
def state_layout(joints: int) -> Layout:
    """Layout of the gate's memory."""
    return layout_of("GateState", _laws.BLOCKS["GateState"], joints)


def initial_gate_state(joints: int) -> Block:
    """The gate before activation: no torque leaves it."""
    state = state_layout(joints).zeros()
    state.stop_joint = -1.0
    state.last_tick = -1.0
    return state


def activate(gate_state: Block, limits: Block, applied: ArrayLike) -> Block:
    """The gate open, with `applied` (n,) N m as the torque that the drive holds now. A latched stop stays latched.

    The commands get as many samples to catch up as the rate limit needs across the whole torque range; rate excesses in
    that time are limited and counted, but do not stop the robot.
    """
    state = caught_up(gate_state, limits)
    state.active = 1.0
    state.last_torque = np.asarray(applied, dtype=float)
    return state


def deactivate(gate_state: Block) -> Block:
    """The gate closed: zero torque from the next sample. The latch stays as it is."""
    state = gate_state.copy()
    state.active = 0.0
    return state


def stopped_by(gate_state: Block, code: FaultCode, joint: int) -> Block:
    """The gate after a stop that its caller demands: torque ramps to zero from the next sample on, latched."""
    state = gate_state.copy()
    _stop(state, code, joint)
    return state


def caught_up(gate_state: Block, limits: Block) -> Block:
    """The gate before a new source of commands: rate excesses count anew, after the time to cross the torque range."""
    state = gate_state.copy()
    state.rate_excess_run = 0.0
    state.catch_up = np.ceil(2.0 * limits.torque_limit / limits.torque_step)
    return state


def reset(gate_state: Block, measured: Block, limits: Block) -> tuple[Block, list[str]]:
    """Ends a latched stop. Returns (new state, []) or (the state as it was, every reason for refusing).

    Of `measured` only `joint_velocity` (n,) rad/s is looked at.
    """
    reasons = []
    healthy, wanted = float(gate_state.healthy_samples), float(limits.reset_samples)
    if not healthy >= wanted:
        reasons.append(f"inputs healthy for {healthy:g} samples, {wanted:g} needed; wait or repair them")
    for joint in range(gate_state.joints):
        velocity, still = float(measured.joint_velocity[joint]), float(limits.standstill_velocity)
        if not abs(velocity) <= still:
            reasons.append(f"joint_{joint + 1} moves with {velocity:.4g} rad/s, limit {still:g} rad/s; wait for rest")
        if not gate_state.last_torque[joint] == 0.0:
            reasons.append(
                f"joint_{joint + 1} torque ramp runs at {gate_state.last_torque[joint]:.4g} N m; wait for zero"
            )
    if reasons:
        return gate_state.copy(), reasons
    state = gate_state.copy()
    state.stopped = state.brake_requested = state.stop_code = 0.0
    state.stop_joint = -1.0
    if state.active == 1.0:
        state = activate(state, limits, state.last_torque)
    return state, []


def safety_gate(
    command: FloatArray, measured: Block, ages: FloatArray, ticks: FloatArray, limits: Block, gate_state: Block
) -> tuple[FloatArray, Block, list[Fault]]:
    """One sample. Returns the torque that may leave (n,) N m, the new state, and the faults of this sample.

    `command` (n,) N m; `ages` (n,) samples since each command was computed from its oldest input; `ticks` (n,) tick
    numbers of those inputs; `limits` from `limits.configure_gate`; `measured` is not looked at so far.
    """
    joints = gate_state.layout.joints
    out = np.empty(joints)
    new_array = np.empty(gate_state.layout.size)
    rows = np.empty(joints * _laws.FAULTS_PER_JOINT * _laws.FAULT_FIELDS)
    count = _laws.gate_step(command, ages, ticks, limits.array, gate_state.array, out, new_array, rows, joints)
    return out, Block(gate_state.layout, new_array), faults_from_rows(rows, count) if count else []


def faults_from_rows(rows: FloatArray, count: int) -> list[Fault]:
    """The first `count` fault rows (code, joint, value, limit, action) of the compiled gate as values."""
    table = rows[: count * _laws.FAULT_FIELDS].reshape(count, _laws.FAULT_FIELDS).tolist()
    return [
        Fault(FaultCode(int(code)), int(joint), value, limit, Action(int(action)))
        for code, joint, value, limit, action in table
    ]


def _stop(state: Block, code: FaultCode, joint: int) -> None:
    """Latches a stop; the first cause keeps its name."""
    if state.stopped == 0.0:
        state.stopped = state.brake_requested = 1.0
        state.stop_code, state.stop_joint = float(code), float(joint)
