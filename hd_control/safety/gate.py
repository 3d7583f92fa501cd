"""Safety gate: the last layer before the motor command. It does not trust the controller.

One pure function, `safety_gate`. No clock, no file, no randomness, no exception for any number. Order of the checks:
finite -> tick and age -> active and latch -> size -> rate (against the torque that last left the gate).

- A compliant command leaves bit for bit as it came. Not active: exactly zero torque.
- Too large or too fast: limited, counted, reported. Too fast many times in a row: stop.
- Not finite, too old, or a tick that is not above the last one used: stop.
- A stop latches for all joints of the block: torque ramps to zero at the rate limit without changing sign, and the
  brake is requested. Only `reset` ends it.

Comparisons are written so that a NaN fails them. `safety_gate_compiled` is the same in C++, equal bit for bit.
This is not a certified safety function: a real arm needs a hardware emergency stop and brakes of its own.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.safety.limits import limits_layout

LARGEST_TICK = 2.0**53
_MEASURED = (("joint_position", 1, "rad", "q"), ("joint_velocity", 1, "rad/s", "D(q)"))


@lru_cache
def state_layout(joints: int) -> Layout:
    """Layout of the gate's memory."""
    return layout_of("GateState", _laws.BLOCKS["GateState"], joints)


def new_measured(joints: int) -> Block:
    """Empty block of the measurements that the gate looks at: joint_position, joint_velocity."""
    return layout_of("GateMeasured", _MEASURED, joints).zeros()


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
    """Ends a latched stop. Returns (new state, []) or (the state as it was, every reason for refusing)."""
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
    numbers of those inputs; `limits` from `gate_limits.configure`; `measured` is looked at by `reset` only, so far.
    """
    state, faults = gate_state.copy(), list[Fault]()
    active = bool(state.active != 0.0)
    emitting = active and bool(state.stopped == 0.0)
    healthy = True
    for j in range(state.joints):
        code = _check_input(float(command[j]), float(ages[j]), float(ticks[j]), j, emitting, limits, state, faults)
        healthy = healthy and code is None
        if code is not None and active:
            _stop(state, code, j)
    state.healthy_samples = state.healthy_samples + 1.0 if healthy else 0.0

    out = np.zeros(state.joints)
    if active and state.stopped == 0.0:
        for j in range(state.joints):
            out[j] = _limit_command(float(command[j]), j, limits, state, faults)
            if not state.rate_excess_run[j] < limits.rate_excess_limit:
                run, allowed = float(state.rate_excess_run[j]), float(limits.rate_excess_limit)
                faults.append(Fault(FaultCode.RATE_PERSISTENT, j, run, allowed, Action.TORQUE_RAMP))
                _stop(state, FaultCode.RATE_PERSISTENT, j)
    if active and state.stopped != 0.0:
        for j in range(state.joints):
            out[j] = _ramp(j, limits, state)
    state.last_torque = out
    return out, state, faults


def safety_gate_compiled(
    command: FloatArray, measured: Block, ages: FloatArray, ticks: FloatArray, limits: Block, gate_state: Block
) -> tuple[FloatArray, Block, list[Fault]]:
    """`safety_gate`, compiled: same arguments, same result bit for bit."""
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


def _check_input(
    command: float, age: float, tick: float, j: int, emitting: bool, limits: Block, state: Block, faults: list[Fault]
) -> FaultCode | None:
    """Finite, tick, age. Returns the first reason to stop. While nothing is emitted the tick only follows."""
    action = Action.TORQUE_RAMP if emitting else Action.REPORT
    found: list[Fault] = []
    if not abs(command) < math.inf:
        found.append(Fault(FaultCode.NOT_FINITE, j, command, 0.0, action))
    known = 0.0 <= tick <= LARGEST_TICK
    advances = known and tick > state.last_tick[j]
    if not advances:
        found.append(Fault(FaultCode.STAMP_STUCK, j, tick, float(state.last_tick[j]), action))
    if advances or (known and not emitting):
        state.last_tick[j] = tick
    if not 0.0 <= age < limits.age_limit:
        found.append(Fault(FaultCode.NODE_KILLED, j, age, float(limits.age_limit), action))
    faults.extend(found)
    return found[0].code if found else None


def _stop(state: Block, code: FaultCode, joint: int) -> None:
    """Latches a stop; the first cause keeps its name."""
    if state.stopped == 0.0:
        state.stopped = state.brake_requested = 1.0
        state.stop_code, state.stop_joint = float(code), float(joint)


def _reference(j: int, limits: Block, state: Block) -> float:
    """The last torque as a reference for the rate: bounded whatever the memory holds."""
    last, limit = float(state.last_torque[j]), float(limits.torque_limit[j])
    if -limit <= last <= limit:
        return last
    return 0.0 if math.isnan(last) else math.copysign(limit, last)


def _limit_command(u: float, j: int, limits: Block, state: Block, faults: list[Fault]) -> float:
    """Size, then rate. `u` is finite."""
    limit, step, last = float(limits.torque_limit[j]), float(limits.torque_step[j]), _reference(j, limits, state)
    if not -limit <= u <= limit:
        faults.append(Fault(FaultCode.TORQUE_LIMITED, j, u, limit, Action.REPORT))
        state.saturated_samples[j] += 1.0
        u = limit if u > 0.0 else -limit
    low, high = last - step, last + step
    if low <= u <= high:
        state.rate_excess_run[j] = state.catch_up[j] = 0.0
        return u
    faults.append(Fault(FaultCode.RATE_LIMITED, j, u - last, step, Action.REPORT))
    state.rate_limited_samples[j] += 1.0
    if state.catch_up[j] > 0.0:
        state.catch_up[j] -= 1.0
    else:
        state.rate_excess_run[j] += 1.0
    return high if u > high else low


def _ramp(j: int, limits: Block, state: Block) -> float:
    """The last torque one step closer to zero, never across it."""
    last, step = _reference(j, limits, state), float(limits.torque_step[j])
    return last - step if last > step else (last + step if last < -step else 0.0)


__all__ = [
    "activate",
    "caught_up",
    "deactivate",
    "faults_from_rows",
    "initial_gate_state",
    "limits_layout",
    "new_measured",
    "reset",
    "safety_gate",
    "safety_gate_compiled",
    "state_layout",
    "stopped_by",
]
