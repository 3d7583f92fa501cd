"""Guard: the safety gate with a controlled stop in front of it. The same object stands on both sides of the wire.

    command -> inputs healthy? -> envelope -> strongest action -> law's torque | stop torque | ramp -> safety gate

Actions (docs/safety.md): a fault of action CONTROLLED_STOP decelerates and holds (A2); without a usable motor position,
or when the stop is left, and for TORQUE_RAMP, the gate ramps the torque to zero and the brake is requested (A3). The
drive side holds only while its brakes close. Both latch for all joints; only `reset` ends them. No clock, no file, no
exception for any number. This is not a certified safety function.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Action, Fault, FaultCode, strongest
from hd_control.safety import gate as gate
from hd_control.safety.limits import SafetyLimits

# ----------------------------------------------------------------------------------------------------
# Controlled stop (action A2): decelerates on the motor side, then holds the place. Pure functions on blocks.
#
#     v_r falls from the present velocity to 0 at stop_deceleration, x_r is its integral;
#     u = hold_torque - stop_damping (v - v_r) - stop_stiffness (x - x_r)
#
# `hold_torque` is the mean torque of the last 50 samples, so it carries the weight of the arm without any model. x and
# v are motor position and velocity at the output side: feedback at the motor's own end of the spring cannot excite it.


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


# ----------------------------------------------------------------------------------------------------


_MEASURED = (
    ("motor_position", 1, "rad", "phi"),
    ("motor_velocity", 1, "rad/s", "D(phi)"),
    ("joint_position", 1, "rad", "q"),
    ("joint_velocity", 1, "rad/s", "D(q)"),
)
SPEED_SHARE = 1.2
"""A joint faster than this share of its velocity limit is stopped."""
OUTWARD_SPEED = 0.05
"""rad/s; slower motion outside the envelope is noise, or the way back."""


class Mode(enum.IntEnum):
    """What leaves: nothing, the law's torque, the torque of a controlled stop, or the ramp to zero."""

    INACTIVE = 0
    ACTIVE = 1
    STOPPING = 2
    HOLDING = 3
    STOPPED = 4


def new_measured(joints: int) -> Block:
    """Empty block of what the guard looks at: motor and joint, position and velocity."""
    return layout_of("GuardMeasured", _MEASURED, joints).zeros()


class Guard:
    """State and step of one side. `low`, `high` (n,) rad and `speed` (n,) rad/s: limits of the joints of the robot.

    `hold_samples` 0: a controlled stop holds without end.
    """

    def __init__(
        self,
        limits: SafetyLimits,
        low: FloatArray,
        high: FloatArray,
        speed: FloatArray,
        dt: float,
        hold_samples: int = 0,
    ) -> None:
        self.limits, self.low, self.high, self.dt, self.hold_samples = limits, low, high, dt, hold_samples
        self._speed = SPEED_SHARE * speed
        self.gate = gate.initial_gate_state(limits.joints)
        self.stop = initial_stop(limits.joints)
        self.measured = new_measured(limits.joints)
        self.controlled = False
        self.healthy = 0
        self._tick = np.full(limits.joints, -1.0)
        self._no_age = np.zeros(limits.joints)
        # Views and arrays of the hot path, looked up once.
        self._age_limit = float(limits.gate.age_limit)
        self._twice_deceleration = 2.0 * limits.guard.stop_deceleration
        self._position, self._velocity = self.measured.joint_position, self.measured.joint_velocity
        self._emitting = False
        self._mean = np.zeros(limits.joints)
        self.bounds = np.stack([low, high, self._speed, self._twice_deceleration])
        """Rows of the envelope (4, n): lowest and highest position, largest speed, twice the stop's deceleration."""
        self._look_limits = (*self.bounds, self._age_limit, gate.LARGEST_TICK)

    @property
    def mode(self) -> Mode:
        """The state as the safety notes name it."""
        if self._emitting:
            return Mode.ACTIVE
        if self.gate.active == 0.0:
            return Mode.INACTIVE
        if self.gate.stopped != 0.0:
            return Mode.STOPPED
        return Mode.HOLDING if resting(self.stop) else Mode.STOPPING

    @property
    def stopped(self) -> bool:
        """True after a latched stop of either kind."""
        return not self._emitting and (self.controlled or bool(self.gate.stopped != 0.0))

    @property
    def last_tick(self) -> FloatArray:
        """Ticks (n,) of the last commands looked at."""
        return self._tick

    def activate(self, applied: FloatArray) -> None:
        """Opens with the torque (n,) N m that the drive holds now. A latched stop stays latched."""
        self.gate = gate.activate(self.gate, self.limits.gate, applied)
        self._mean[:] = applied
        self._look()

    def deactivate(self) -> None:
        """Closed: zero torque from the next sample. A controlled stop ends as a ramp that has ended."""
        if self.controlled:
            self.gate = gate.stopped_by(self.gate, FaultCode.STOP_LEFT, -1)
        self.gate = gate.deactivate(self.gate)
        self._look()

    def _look(self) -> None:
        """After any change of the state: may the law's torque leave?"""
        self._emitting = not self.controlled and bool(self.gate.active != 0.0) and bool(self.gate.stopped == 0.0)

    def step(
        self, command: FloatArray, ages: FloatArray, ticks: FloatArray, demands: Sequence[Fault] = ()
    ) -> tuple[FloatArray, list[Fault]]:
        """One sample: the torque that may leave (n,) N m, and its faults. `demands` are those of the monitors."""
        if self._emitting and not demands and self._quiet(command, ages, ticks):
            out, new, faults = gate.safety_gate(command, self.measured, ages, ticks, self.limits.gate, self.gate)
            if not faults:
                return self._ordinary(out, new, ticks), faults
        with np.errstate(all="ignore"):  # infinite inputs are judged below, not warned of
            return self._judged(command, ages, ticks, demands)

    def _quiet(self, command: FloatArray, ages: FloatArray, ticks: FloatArray) -> bool:
        """Have `_input_faults` and `_envelope_faults` nothing to say? All at once, compiled."""
        return _laws.guard_is_quiet(
            command, ages, ticks, self._tick, self._position, self._velocity, *self._look_limits
        )

    def _ordinary(self, out: FloatArray, new: Block, ticks: FloatArray) -> FloatArray:
        """The end of a sample without any finding: what `_judged` comes to then."""
        self.gate = new
        self.healthy += 1
        self._mean += (out - self._mean) / MEAN_SAMPLES
        self._tick = ticks.copy()
        return out

    def _judged(
        self, command: FloatArray, ages: FloatArray, ticks: FloatArray, demands: Sequence[Fault]
    ) -> tuple[FloatArray, list[Fault]]:
        emitting = self._emitting
        found = [*demands, *self._input_faults(command, ages, ticks), *self._envelope_faults()]
        action = strongest(found)
        self.healthy = self.healthy + 1 if action < Action.CONTROLLED_STOP else 0
        if action >= Action.CONTROLLED_STOP:
            self._stop(found, action)
        if self.controlled:
            out, gate_faults = self._controlled(found)
        else:
            out, gate_faults = self._through_or_stop(command, ages, ticks, found)
            self._mean += (out - self._mean) / MEAN_SAMPLES
        known = {(fault.code, fault.joint) for fault in found}
        found += [fault for fault in gate_faults if (fault.code, fault.joint) not in known]
        self._tick = np.fmax(ticks, self._tick)
        if found:
            self._look()
        return out, found if emitting else [_reported(fault) for fault in found]

    def _through_or_stop(
        self, command: FloatArray, ages: FloatArray, ticks: FloatArray, found: list[Fault]
    ) -> tuple[FloatArray, list[Fault]]:
        """The gate; a stop that the gate itself wants becomes a controlled one while that is possible."""
        before = self.gate
        out, faults = self._through(command, ages, ticks)
        stops = [fault for fault in faults if fault.action >= Action.CONTROLLED_STOP]
        if not (stops and self._emitting and stops[0].code is FaultCode.RATE_PERSISTENT):
            return out, faults
        self.gate, self.healthy = before, 0
        found += [Fault(f.code, f.joint, f.value, f.limit, Action.CONTROLLED_STOP) for f in stops]
        self._stop(found, Action.CONTROLLED_STOP)
        return self._controlled(found) if self.controlled else self._through(command, ages, ticks)

    def reset(self, reasons: Sequence[str] = ()) -> list[str]:
        """Ends a latched stop if all is healthy, still and none of the caller's `reasons` speaks against it.

        Returns the reasons of a refusal; none if there is nothing to end.
        """
        if not self.stopped:
            return []
        trial = self.gate.copy()
        trial.healthy_samples = float(self.healthy)
        if self.controlled:
            trial.last_torque = 0.0
        new, refused = gate.reset(trial, self.measured, self.limits.gate)
        refused = [*refused, *reasons]
        if refused:
            return refused
        self.gate, self.controlled = self._reopened(new), False
        self._look()
        return []

    def _reopened(self, new: Block) -> Block:
        """After a reset: ticks of the source count again, the torque goes on from the one that was held."""
        new.last_tick, new.last_torque = self._tick, self.gate.last_torque
        return new

    def _input_faults(self, command: FloatArray, ages: FloatArray, ticks: FloatArray) -> list[Fault]:
        """Commands that are not finite, too old, or not newer than the last ones."""
        finite = np.isfinite(command)
        fresh = (ticks > self._tick) & (ticks <= gate.LARGEST_TICK)
        young = (ages >= 0.0) & (ages < self._age_limit)
        found = []
        for code, good, values, bounds in (
            (FaultCode.NOT_FINITE, finite, command, self._no_age),
            (FaultCode.STAMP_STUCK, fresh, ticks, self._tick),
            (FaultCode.NODE_KILLED, young, ages, self._no_age + self._age_limit),
        ):
            found += [
                Fault(code, int(j), float(values[j]), float(bounds[j]), Action.CONTROLLED_STOP)
                for j in np.flatnonzero(~good)
            ]
        return found

    def _envelope_faults(self) -> list[Fault]:
        """A joint that is too fast, or moves outward and could no longer stop inside: q + v|v| / (2 a) outside."""
        if not self._emitting:
            return []
        velocity, low, high = self._velocity, self.low, self.high
        end = self._position + velocity * np.abs(velocity) / self._twice_deceleration
        fast = (np.abs(velocity) > self._speed) & np.isfinite(velocity)
        outward = ((end > high) & (velocity > OUTWARD_SPEED)) | ((end < low) & (velocity < -OUTWARD_SPEED))
        bound, action = np.where(velocity > 0.0, high, low), Action.CONTROLLED_STOP
        return [
            *(Fault(FaultCode.OVERSPEED, int(j), float(velocity[j]), float(self._speed[j]), action)
              for j in np.flatnonzero(fast)),
            *(Fault(FaultCode.ENVELOPE, int(j), float(end[j]), float(bound[j]), action)
              for j in np.flatnonzero(outward)),
        ]  # fmt: skip

    def _stop(self, found: Sequence[Fault], action: Action) -> None:
        """Begins what the strongest fault demands; a stop that runs is never replaced by a weaker one."""
        if self.gate.active == 0.0 or self.gate.stopped != 0.0:
            return
        first = next(fault for fault in found if fault.action == action)
        position, velocity = self.measured.motor_position, self.measured.motor_velocity
        usable = bool(np.isfinite(position).all() and np.isfinite(velocity).all())
        if action >= Action.TORQUE_RAMP or not usable:
            self.gate, self.controlled = gate.stopped_by(self.gate, first.code, first.joint), False
        elif not self.controlled:
            self.stop, self.controlled = begin(self._mean, position, velocity), True
            self.gate = gate.caught_up(self.gate, self.limits.gate)

    def _controlled(self, found: list[Fault]) -> tuple[FloatArray, list[Fault]]:
        """The stop torque through the gate, or the ramp when the stop is left or its time is over."""
        position, velocity = self.measured.motor_position, self.measured.motor_velocity
        torque, self.stop = stop_torque(self.stop, position, velocity, self.limits.guard, self.dt)
        joint = left(self.stop, velocity)
        if joint >= 0 or not np.isfinite(torque).all():
            joint = max(joint, 0)
            bound = float(self.stop.first_speed[joint]) + SPEED_MARGIN
            found.append(Fault(FaultCode.STOP_LEFT, joint, float(velocity[joint]), bound, Action.TORQUE_RAMP))
            self.gate = gate.stopped_by(self.gate, FaultCode.STOP_LEFT, joint)
        elif 0 < self.hold_samples <= self.stop.elapsed:
            self.gate = gate.stopped_by(self.gate, FaultCode.STOP_LEFT, -1)
        return self._through(torque, self._no_age, self.gate.last_tick + 1.0)

    def _through(self, command: FloatArray, ages: FloatArray, ticks: FloatArray) -> tuple[FloatArray, list[Fault]]:
        """The gate, always the last. A stop that it begins itself ends a controlled one."""
        out, self.gate, faults = gate.safety_gate(command, self.measured, ages, ticks, self.limits.gate, self.gate)
        self.controlled = self.controlled and bool(self.gate.stopped == 0.0)
        return out, faults


def _reported(fault: Fault) -> Fault:
    """The same finding while nothing of the law leaves: it is reported, and demands nothing."""
    return Fault(fault.code, fault.joint, fault.value, fault.limit, Action.REPORT)
