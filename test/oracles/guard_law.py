"""The guard once more, in plain Python: the gate with a controlled stop in front of it, each sample judged in full.

    command -> inputs healthy? -> envelope -> strongest action -> law's torque | stop torque | ramp -> safety gate

No short way for an ordinary sample. What is shared with the guard under test: names of faults and limits.
"""

import numpy as np
from oracles import gate_law

from hd_control.core.blocks import layout_of
from hd_control.core.faults import Action, Fault, FaultCode, strongest

INACTIVE, ACTIVE, STOPPING, HOLDING, STOPPED = range(5)
MEAN_SAMPLES = 50.0
SPEED_MARGIN = 0.3
"""rad/s; a joint that becomes faster than at the begin of the stop by more than this has left the stop."""
SPEED_SHARE = 1.2
"""A joint faster than this share of its velocity limit is stopped."""
OUTWARD_SPEED = 0.05
"""rad/s; slower motion outside the envelope is noise, or the way back."""
_STOP = (
    ("elapsed", 0, "samples", "samples since the stop began"),
    ("hold_torque", 1, "N m", "mean torque before the stop"),
    ("reference_position", 1, "rad", "x_r"),
    ("reference_velocity", 1, "rad/s", "v_r"),
    ("first_speed", 1, "rad/s", "speed when the stop began"),
)
_MEASURED = (
    ("motor_position", 1, "rad", "phi"),
    ("motor_velocity", 1, "rad/s", "D(phi)"),
    ("joint_position", 1, "rad", "q"),
    ("joint_velocity", 1, "rad/s", "D(q)"),
)


def initial_stop(joints):
    """Nothing applied yet."""
    return layout_of("StopState", _STOP, joints).zeros()


def new_measured(joints):
    """Empty block of what the guard looks at: motor and joint, position and velocity."""
    return layout_of("GuardMeasured", _MEASURED, joints).zeros()


def begin(mean_torque, position, velocity):
    """The stop begins at motor position (n,) rad and velocity (n,) rad/s with the mean torque (n,) N m from before."""
    new = initial_stop(position.size)
    new.hold_torque = mean_torque
    new.reference_position, new.reference_velocity = position, velocity
    new.first_speed = np.abs(velocity)
    return new


def stop_torque(state, position, velocity, limits, dt):
    """Torque (n,) N m of one sample of the stop, before any limit, and the new memory. `limits`: GuardLimits.

    v_r falls to 0 at the stop's deceleration, x_r is its integral, on the motor side:
    u = hold_torque - stop_damping (v - v_r) - stop_stiffness (x - x_r)
    """
    new = state.copy()
    new.elapsed = state.elapsed + 1.0
    before = state.reference_velocity
    new.reference_velocity = np.copysign(np.fmax(np.abs(before) - limits.stop_deceleration * dt, 0.0), before)
    new.reference_position = state.reference_position + new.reference_velocity * dt
    damping = limits.stop_damping * (velocity - new.reference_velocity)
    return state.hold_torque - damping - limits.stop_stiffness * (position - new.reference_position), new


def left(state, velocity):
    """The first joint that moves faster than the stop allows, -1 if none does. A velocity that is NaN has left it."""
    for j, speed in enumerate(np.abs(velocity)):
        if not speed <= state.first_speed[j] + SPEED_MARGIN:
            return j
    return -1


def resting(state):
    """True once the reference stands: the state is HOLDING, before that STOPPING."""
    return not bool(np.any(state.reference_velocity))


class Guard:
    """State and step of one side, with the arguments of `hd_control.safety.guard.Guard`."""

    def __init__(self, limits, low, high, speed, dt, hold_samples=0):
        n = limits.joints
        self.limits, self.low, self.high, self.speed = limits, low, high, SPEED_SHARE * speed
        self.dt, self.hold_samples = dt, hold_samples
        self.gate, self.stop, self.measured = gate_law.initial_gate_state(n), initial_stop(n), new_measured(n)
        self.controlled, self.healthy = False, 0
        self.last_tick, self.mean_torque = np.full(n, -1.0), np.zeros(n)

    @property
    def emitting(self):
        """May the law's torque leave?"""
        return not self.controlled and bool(self.gate.active != 0.0) and bool(self.gate.stopped == 0.0)

    @property
    def mode(self):
        """The number of the state."""
        if self.emitting:
            return ACTIVE
        if self.gate.active == 0.0:
            return INACTIVE
        if self.gate.stopped != 0.0:
            return STOPPED
        return HOLDING if resting(self.stop) else STOPPING

    @property
    def stopped(self):
        """True after a latched stop of either kind."""
        return self.controlled or bool(self.gate.stopped != 0.0)

    def activate(self, applied):
        """Opens with the torque (n,) N m that the drive holds now. A latched stop stays latched."""
        self.gate = gate_law.activate(self.gate, self.limits.gate, applied)
        self.mean_torque = np.array(applied, dtype=float)

    def deactivate(self):
        """Closed: zero torque from the next sample. A controlled stop ends as a ramp that has ended."""
        if self.controlled:
            self.gate = gate_law.stopped_by(self.gate, FaultCode.STOP_LEFT, -1)
        self.gate = gate_law.deactivate(self.gate)

    def reset(self, reasons=()):
        """Ends a latched stop; returns the reasons of a refusal, those of the caller last."""
        if not self.stopped:
            return []
        trial = self.gate.copy()
        trial.healthy_samples = float(self.healthy)
        if self.controlled:
            trial.last_torque = 0.0
        new, refused = gate_law.reset(trial, self.measured.joint_velocity, self.limits.gate)
        if refused or reasons:
            return [*refused, *reasons]
        # Ticks of the source count again, the torque goes on from the one that was held.
        new.last_tick, new.last_torque = self.last_tick, self.gate.last_torque
        self.gate, self.controlled = new, False
        return []

    def step(self, command, ages, ticks, demands=()):
        """One sample: the torque that may leave (n,) N m, and its faults. `demands` are those of the monitors."""
        emitting = self.emitting
        found = [*demands, *self._input_faults(command, ages, ticks)]
        if emitting:
            found += self._envelope_faults()
        action = strongest(found)
        self.healthy = self.healthy + 1 if action < Action.CONTROLLED_STOP else 0
        if action >= Action.CONTROLLED_STOP:
            self._begin_stop(found, action)
        if self.controlled:
            out, of_the_gate = self._controlled(found)
        else:
            out, of_the_gate = self._through_or_stop(command, ages, ticks, found)
            self.mean_torque = self.mean_torque + (out - self.mean_torque) / MEAN_SAMPLES
        known = {(fault.code, fault.joint) for fault in found}
        found += [fault for fault in of_the_gate if (fault.code, fault.joint) not in known]
        self.last_tick = np.fmax(ticks, self.last_tick)
        return out, found if emitting else [Fault(f.code, f.joint, f.value, f.limit, Action.REPORT) for f in found]

    def _input_faults(self, command, ages, ticks):
        """Commands that are not finite, too old, or not newer than the last ones."""
        age_limit, found = float(self.limits.gate.age_limit), []
        for j, value in enumerate(command.tolist()):
            if not np.isfinite(value):
                found.append((FaultCode.NOT_FINITE, j, value, 0.0))
        for j, value in enumerate(ticks.tolist()):
            if not (value > self.last_tick[j] and value <= gate_law.LARGEST_TICK):
                found.append((FaultCode.STAMP_STUCK, j, value, float(self.last_tick[j])))
        for j, value in enumerate(ages.tolist()):
            if not (value >= 0.0 and value < age_limit):
                found.append((FaultCode.NODE_KILLED, j, value, age_limit))
        return [Fault(*each, Action.CONTROLLED_STOP) for each in found]

    def _envelope_faults(self):
        """A joint that is too fast, or moves outward and could no longer stop inside: q + v|v| / (2 a) outside."""
        velocity, low, high = self.measured.joint_velocity, self.low, self.high
        end = self.measured.joint_position + velocity * np.abs(velocity) / (2.0 * self.limits.guard.stop_deceleration)
        found = []
        for j, v in enumerate(velocity.tolist()):
            if np.isfinite(v) and abs(v) > self.speed[j]:
                found.append((FaultCode.OVERSPEED, j, v, float(self.speed[j])))
        for j, v in enumerate(velocity.tolist()):
            if end[j] > high[j] and v > OUTWARD_SPEED:
                found.append((FaultCode.ENVELOPE, j, float(end[j]), float(high[j])))
            if end[j] < low[j] and v < -OUTWARD_SPEED:
                found.append((FaultCode.ENVELOPE, j, float(end[j]), float(low[j])))
        return [Fault(*each, Action.CONTROLLED_STOP) for each in found]

    def _begin_stop(self, found, action):
        """Begins what the strongest fault demands; a stop that runs is never replaced by a weaker one."""
        if self.gate.active == 0.0 or self.gate.stopped != 0.0:
            return
        first = next(fault for fault in found if fault.action == action)
        position, velocity = self.measured.motor_position, self.measured.motor_velocity
        usable = bool(np.isfinite(position).all() and np.isfinite(velocity).all())
        if action >= Action.TORQUE_RAMP or not usable:
            self.gate, self.controlled = gate_law.stopped_by(self.gate, first.code, first.joint), False
        elif not self.controlled:
            self.stop, self.controlled = begin(self.mean_torque, position, velocity), True
            self.gate = gate_law.caught_up(self.gate, self.limits.gate)

    def _controlled(self, found):
        """The stop torque through the gate, or the ramp when the stop is left or its time is over."""
        position, velocity = self.measured.motor_position, self.measured.motor_velocity
        torque, self.stop = stop_torque(self.stop, position, velocity, self.limits.guard, self.dt)
        joint = left(self.stop, velocity)
        if joint >= 0 or not np.isfinite(torque).all():
            joint = max(joint, 0)
            bound = float(self.stop.first_speed[joint]) + SPEED_MARGIN
            found.append(Fault(FaultCode.STOP_LEFT, joint, float(velocity[joint]), bound, Action.TORQUE_RAMP))
            self.gate = gate_law.stopped_by(self.gate, FaultCode.STOP_LEFT, joint)
        elif 0 < self.hold_samples <= self.stop.elapsed:
            self.gate = gate_law.stopped_by(self.gate, FaultCode.STOP_LEFT, -1)
        return self._through(torque, np.zeros(torque.size), self.gate.last_tick + 1.0)

    def _through(self, command, ages, ticks):
        """The gate, always the last. A stop that it begins itself ends a controlled one."""
        out, self.gate, faults = gate_law.safety_gate(command, ages, ticks, self.limits.gate, self.gate)
        self.controlled = self.controlled and bool(self.gate.stopped == 0.0)
        return out, faults

    def _through_or_stop(self, command, ages, ticks, found):
        """The gate; a stop that the gate itself wants becomes a controlled one while that is possible."""
        before = self.gate
        out, faults = self._through(command, ages, ticks)
        persistent = [fault for fault in faults if fault.code is FaultCode.RATE_PERSISTENT]
        if not persistent:
            return out, faults
        self.gate, self.healthy = before, 0
        found += [Fault(f.code, f.joint, f.value, f.limit, Action.CONTROLLED_STOP) for f in persistent]
        self._begin_stop(found, Action.CONTROLLED_STOP)
        return self._controlled(found) if self.controlled else self._through(command, ages, ticks)
