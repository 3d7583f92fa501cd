"""The safety gate once more, in plain Python: one sample, joint after joint, the checks in their order.

finite -> tick and age -> active and latch -> size -> rate (against the torque that last left the gate). And what
surrounds it: activation, stop by the caller, reset. Only the words of the faults are shared with the gate under test.
"""

import math

import numpy as np

from hd_control.core.blocks import layout_of
from hd_control.core.faults import Action, Fault, FaultCode

LARGEST_TICK = 2.0**53
_FIELDS = (
    ("active", 0, "-", "1: torque may leave"),
    ("stopped", 0, "-", "1: latched stop, torque ramps to zero"),
    ("brake_requested", 0, "-", "1 from the sample of the stop until the reset"),
    ("stop_code", 0, "-", "fault code of the stop, 0 if none"),
    ("stop_joint", 0, "-", "joint index of the stop, -1 if none"),
    ("healthy_samples", 0, "samples", "healthy samples in a row"),
    ("last_torque", 1, "N m", "last torque that left the gate"),
    ("last_tick", 1, "-", "tick number of the last command used"),
    ("rate_excess_run", 1, "samples", "rate excesses in a row"),
    ("catch_up", 1, "samples", "samples left to reach the law after activation or reset"),
    ("saturated_samples", 1, "samples", "samples limited in size since the start"),
    ("rate_limited_samples", 1, "samples", "samples limited in rate since the start"),
)


def initial_gate_state(joints):
    """The gate before activation: no torque leaves it."""
    state = layout_of("GateState", _FIELDS, joints).zeros()
    state.stop_joint = -1.0
    state.last_tick = -1.0
    return state


def activate(gate_state, limits, applied):
    """The gate open, with `applied` (n,) N m as the torque that the drive holds now. A latched stop stays latched."""
    state = caught_up(gate_state, limits)
    state.active = 1.0
    state.last_torque = np.asarray(applied, dtype=float)
    return state


def deactivate(gate_state):
    """The gate closed: zero torque from the next sample. The latch stays as it is."""
    state = gate_state.copy()
    state.active = 0.0
    return state


def stopped_by(gate_state, code, joint):
    """The gate after a stop that its caller demands: torque ramps to zero from the next sample on, latched."""
    state = gate_state.copy()
    _stop(state, code, joint)
    return state


def caught_up(gate_state, limits):
    """The gate before a new source of commands: rate excesses count anew, after the time to cross the torque range."""
    state = gate_state.copy()
    state.rate_excess_run = 0.0
    state.catch_up = np.ceil(2.0 * limits.torque_limit / limits.torque_step)
    return state


def reset(gate_state, joint_velocity, limits):
    """Ends a latched stop. Returns (new state, []) or (the state as it was, every reason for refusing)."""
    reasons = []
    healthy, wanted = float(gate_state.healthy_samples), float(limits.reset_samples)
    if not healthy >= wanted:
        reasons.append(f"inputs healthy for {healthy:g} samples, {wanted:g} needed; wait or repair them")
    for j in range(gate_state.joints):
        velocity, still = float(joint_velocity[j]), float(limits.standstill_velocity)
        if not abs(velocity) <= still:
            reasons.append(f"joint_{j + 1} moves with {velocity:.4g} rad/s, limit {still:g} rad/s; wait for rest")
        torque = float(gate_state.last_torque[j])
        if not torque == 0.0:
            reasons.append(f"joint_{j + 1} torque ramp runs at {torque:.4g} N m; wait for zero")
    state = gate_state.copy()
    if reasons:
        return state, reasons
    state.stopped = state.brake_requested = state.stop_code = 0.0
    state.stop_joint = -1.0
    if state.active == 1.0:
        state = activate(state, limits, state.last_torque)
    return state, []


def safety_gate(command, ages, ticks, limits, gate_state):
    """Arguments and results of `hd_control.safety.gate.safety_gate`."""
    state, faults = gate_state.copy(), []
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


def _check_input(command, age, tick, j, emitting, limits, state, faults):
    """Finite, tick, age. Returns the first reason to stop. While nothing is emitted the tick only follows."""
    action = Action.TORQUE_RAMP if emitting else Action.REPORT
    found = []
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


def _stop(state, code, joint):
    """Latches a stop; the first cause keeps its name."""
    if state.stopped == 0.0:
        state.stopped = state.brake_requested = 1.0
        state.stop_code, state.stop_joint = float(code), float(joint)


def _reference(j, limits, state):
    """The last torque as a reference for the rate: bounded whatever the memory holds."""
    last, limit = float(state.last_torque[j]), float(limits.torque_limit[j])
    if -limit <= last <= limit:
        return last
    return 0.0 if math.isnan(last) else math.copysign(limit, last)


def _limit_command(u, j, limits, state, faults):
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


def _ramp(j, limits, state):
    """The last torque one step closer to zero, never across it."""
    last, step = _reference(j, limits, state), float(limits.torque_step[j])
    return last - step if last > step else (last + step if last < -step else 0.0)
