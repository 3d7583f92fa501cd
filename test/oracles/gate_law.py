"""The safety gate once more, in plain Python: one sample, joint after joint, the checks in their order.

finite -> tick and age -> active and latch -> size -> rate (against the torque that last left the gate). Only the layout
of the state and the words of the faults are shared with the gate under test.
"""

import math

import numpy as np

from hd_control.core.faults import Action, Fault, FaultCode

LARGEST_TICK = 2.0**53


def safety_gate(command, measured, ages, ticks, limits, gate_state):
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
