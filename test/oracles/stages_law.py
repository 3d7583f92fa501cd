"""The three stages of the tick once more, in plain Python: laws with their monitors, ramps of parameters, guard.

Each works on blocks of its own (`sample`, `reference`) that a test fills before `act(tick)`; then `output`, `state`,
`params` and `found` (the faults of this tick) are what the stage under test must have. The steps of the laws themselves
are those of `hd_control.laws`; they have oracles of their own.
"""

import numpy as np
from oracles import loop_monitors_law, sensor_monitors_law
from oracles.guard_law import ACTIVE, Guard

from hd_control.core.faults import Action, Fault, FaultCode, strongest
from hd_control.laws import fusion, motion, torque
from hd_control.laws.trajectory import TrajectoryFollower

RAMP_TIME, GAIN_TIME = 0.5, 0.1
"""s from an old model to the new one, from old gains and bounds to new ones."""
REDUNDANCY_TICKS, WATCH_TICKS, WARM_TICKS = 4, 10, 50
"""The sensors are compared, the adaptation is looked at every so many ticks."""
LOST_TOLERANCE, REFERENCE_TOLERANCE = 0.05, 0.005
"""rad; a reference further from the joint loses its goal, refuses a reset."""
SLOW_RATE, CHANGE_TIME = 0.25, 0.2
"""Share of the speed that a degraded robot may use; s to get there."""
IDLE_TICKS = 200
"""Of a drive that applies nothing; then the estimates stand, too."""
SENT, OBEYED_SHARE, OBEYED_PART = 16, 0.05, 0.1
"""Commands that are remembered; reported torques are exact to these shares of the limit and of the torque."""
EXCEPTION = Fault(FaultCode.EXCEPTION, -1, 1.0, 0.0, Action.TORQUE_RAMP)


# ---- A change of parameters while the law runs -------------------------------------------------------------------


class ParameterRamp:
    """The way from one parameter block to another, tick by tick. `dt` s is the length of a tick.

    Fields of the model ramp over `RAMP_TIME`, and with them the states that start at them; every other field that has
    values per joint ramps over `GAIN_TIME`; switches and numbers of the whole law act at the next tick.
    """

    def __init__(self, law, before, after, state, dt):
        self.before, self.after, self.tick = before.copy(), after, 0
        self.ticks, gain_ticks = max(1, round(RAMP_TIME / dt)), max(1, round(GAIN_TIME / dt))
        model = getattr(law, "MODEL_FIELDS", ())
        self.fields = {
            field.name: self.ticks if field.name in model else gain_ticks
            for field in after.layout.fields
            if (field.per_joint or field.name in model)
            and not np.array_equal(before.view(field.name), after.view(field.name), equal_nan=True)
        }
        self.moves = {}
        for name, source in getattr(law, "START_VALUES", {}).items():
            if name in state.layout.slices and source in after.layout.slices:
                old, new = before.view(source), after.view(source)
                change = np.where(new != old, new - state.view(name), 0.0)
                if np.any(change != 0.0):
                    self.moves[name] = change / self.ticks
        if not self.moves:
            self.ticks = max(self.fields.values(), default=1)

    def step(self, state):
        """Parameters and state for the next tick; the blocks given stay as they were."""
        self.tick += 1
        state = state.copy()
        for name, change in self.moves.items():
            state.view(name)[...] += change
        params = self.after.copy()
        for name, ticks in self.fields.items():
            if self.tick < min(ticks, self.ticks):
                old, new = self.before.view(name), self.after.view(name)
                params.view(name)[...] = np.where(old == new, new, old + self.tick / ticks * (new - old))
        return params, state


class Stage:
    """One law with its parameters and its memory."""

    def __init__(self, law, params, dt):
        self.law, self.dt, self.tick = law, dt, -1
        self.sample = law.new_sample(params.joints)
        self.reference = law.new_reference(params.joints) if hasattr(law, "new_reference") else None
        self.params = self.newest = self.taken = params
        self.ramp = self.state = self.output = None
        self.found = []

    def adopt(self, params):
        """A new parameter block; the next tick uses it, a changed model ramps from there."""
        self.newest = params
        if self.state is None:
            self.arrive()

    def start(self):
        """A new activation; the state is made anew."""
        self.state, self.tick = None, -1
        self.arrive()

    def arrive(self):
        """The newest parameters as a whole, without a ramp."""
        self.params = self.taken = self.newest
        self.ramp = None

    def advance(self):
        """The law's step with the next parameters on the way to the newest."""
        if self.newest is not self.taken:
            self.taken, self.ramp = self.newest, None
            if self.state is not None:
                self.ramp = ParameterRamp(self.law, self.params, self.newest, self.state, self.dt)
                if not self.ramp.fields:
                    self.ramp = None
            if self.ramp is None:
                self.params = self.newest
        if self.ramp is not None:
            self.params, self.state = self.ramp.step(self.state)
            self.ramp = None if self.ramp.tick >= self.ramp.ticks else self.ramp
        if self.state is None:
            self.state = self.law.initial_state(self.params, self.sample)
        given = (self.sample,) if self.reference is None else (self.sample, self.reference)
        self.output, self.state = self.law.step(self.params, self.state, *given, self.dt)


class FaultLog:
    """Faults of a loop, merged by code and joint; the first that stops keeps its numbers until `clear`."""

    def __init__(self):
        self.clear()

    def clear(self):
        """After a granted reset."""
        self.entries, self.first_stop, self.first_stop_tick = {}, None, -1

    def note(self, faults, tick):
        """Counts the faults of one tick."""
        for fault in faults:
            key = fault.code, fault.joint
            count, first_tick, first = self.entries.get(key, (0, tick, fault))
            self.entries[key] = count + 1, first_tick, first
            if self.first_stop is None and fault.action >= Action.CONTROLLED_STOP:
                self.first_stop, self.first_stop_tick = fault, tick

    def values(self, joint_names):
        """One text for each code and joint."""
        found = {}
        for (code, joint), (count, tick, first) in self.entries.items():
            where = "robot" if joint < 0 else joint_names[joint]
            found[f"{code.text} {where}"] = f"{count} times since tick {tick}: {first.text(joint_names)}"
        return found


# ---- Fusion between the sensor monitors --------------------------------------------------------------------------


class FusionStage(Stage):
    """Bad readings are bridged or withheld; where sensors disagree the joint torque is withheld."""

    def __init__(self, params, dt, limits):
        super().__init__(fusion, params, dt)
        n, guard = params.joints, limits.guard
        self.limits, self.faults = guard, FaultLog()
        self.limit = np.stack([guard.position_step_limit, guard.position_step_limit, guard.gauge_step_limit])
        self.raw, self.missed_motion = self.sample.copy(), np.zeros(n)
        self._forget()

    def _forget(self):
        n = self.sample.joints
        self.screen = self.frozen = self.redundancy = self.stuck = None
        self.warm = [sensor_monitors_law.Temperatures() for _ in range(n)]
        self.apart, self.railed = np.zeros(n), np.zeros(n)

    def start(self):
        super().start()
        self._forget()

    def act(self, tick):
        """One tick."""
        self.raw.array[:] = self.sample.array
        self.found = [*self._before(), *self._temperatures()]
        self.advance()
        self.found += self._after(tick)
        self.tick = tick
        self.faults.note(self.found, tick)

    def _before(self):
        """Screens the readings in place."""
        names = ("motor_shaft_position", "joint_position", "gauge_torque")
        model, one = self.newest, np.ones(self.sample.joints)
        scale = np.stack([model.gear_ratio, one, one])
        period = np.stack([model.encoder_period / model.gear_ratio, model.resolver_period, 0.0 * one])
        reading = np.stack([self.sample.view(name) for name in names]) / scale
        if self.screen is None:
            self.screen = sensor_monitors_law.first_screen(reading)
            self.frozen = sensor_monitors_law.Frozen(reading[2].copy(), 0.0 * one, reading[0].copy())
            return []
        used, self.screen, faults = sensor_monitors_law.screen(
            reading, self.screen, self.limit, period, self.limits.rejected_samples
        )
        for row, name in enumerate(names):
            changed = ~(used[row] == reading[row])
            self.sample.view(name)[changed] = (used[row] * scale[row])[changed]
        return faults

    def _temperatures(self):
        """Screens the motor temperatures in place."""
        found, temperature = [], self.sample.motor_temperature
        for j, memory in enumerate(self.warm):
            temperature[j], finding = memory.step(float(temperature[j]), self.limits, self.dt)
            if finding is not None:
                found.append(Fault(FaultCode.TEMPERATURE_BAD, j, *finding, Action.REPORT))
        return found

    def _after(self, tick):
        """Compares the sensors with each other; withholds the joint torque where they disagree."""
        out, limits, gauge = self.output, self.limits, self.sample.gauge_torque
        apart, self.apart, faults = sensor_monitors_law.disagree(
            out.motor_position, out.resolver_position, self.apart, limits
        )
        railed, self.railed, rail = sensor_monitors_law.at_rail(gauge, self.railed, limits)
        frozen, self.frozen, still = sensor_monitors_law.frozen(gauge, out.motor_position, self.frozen, limits)
        compared = self._compare() if tick % REDUNDANCY_TICKS == 0 else []
        stops = apart | railed | frozen
        for fault in compared:
            stops[fault.joint] |= fault.action is Action.CONTROLLED_STOP
        out.joint_torque[stops] = np.nan
        return [*faults, *rail, *still, *compared]

    def _compare(self):
        """The relation between the three sensors, Zhu (1), and positions that do not take part in it any more."""
        out, stiffness = self.output, self.newest.torsional_stiffness
        positions = np.stack([out.motor_position, out.resolver_position])
        twist = out.joint_torque / stiffness - out.kinematic_error
        memory = self.stuck or sensor_monitors_law.first_stuck(positions)
        self.missed_motion, self.stuck, stuck = sensor_monitors_law.stuck(
            positions, twist, memory, self.limits.frozen_samples, self.limits.stuck_motion_limit, REDUNDANCY_TICKS
        )
        residual = out.joint_torque - stiffness * (out.motor_position + out.kinematic_error - out.resolver_position)
        known = self.redundancy or sensor_monitors_law.first_redundancy(out.motor_shaft_position)
        self.redundancy, faults = sensor_monitors_law.redundancy(
            residual, out.motor_shaft_position, out.gauge_angle, known, self.limits
        )
        return [*stuck, *faults]


# ---- The motion law with the trajectory in front of it -----------------------------------------------------------


class SlowMotion:
    """Rate of the path's time and how many ticks it lags behind. `period` s is the length of a tick.

    `path tick = tick - lag`; the rate falls from 1 to `SLOW_RATE` within `CHANGE_TIME` and rises again in the same way:
    q(path tick), q' = rate v, q'' = rate^2 a + rate' v.
    """

    def __init__(self, period):
        self.period, self.slope = period, 0.0
        self.reset()

    def reset(self):
        """Full rate, no lag."""
        self.rate, self.lag = 1.0, 0.0

    @property
    def at_rest(self):
        """True while the path's time is the time."""
        return self.rate == 1.0 and self.lag == 0.0

    def step(self, slow):
        """One tick towards the wanted rate."""
        before, step = self.rate, (1.0 - SLOW_RATE) * self.period / CHANGE_TIME
        self.rate = max(SLOW_RATE, before - step) if slow else min(1.0, before + step)
        self.slope = (self.rate - before) / self.period
        self.lag += 1.0 - 0.5 * (self.rate + before)

    def scale(self, reference):
        """Velocity and acceleration of the path become those of the reference, in place."""
        velocity, acceleration = reference.desired_velocity, reference.desired_acceleration
        acceleration[:] = acceleration * (self.rate * self.rate) + self.slope * velocity
        velocity[:] = velocity * self.rate


class MotionStage(Stage):
    """Follows one path, holds the measured position before the first and after a joint has lost its reference.

    `controller_mode`: the mode of the torque law as text, "" before the first.
    """

    def __init__(self, params, dt, joint_names, blend_time):
        super().__init__(motion, params, dt)
        self.joint_names, self.blend_time = joint_names, blend_time
        self.follower = self.path = None
        self.slow, self.controller_mode = SlowMotion(dt), ""
        self.reset_asked, self.resets = False, 0
        self.late_goals = self.aborted_goals = 0

    def start(self):
        """Link parameters survive, the reference starts at the measured position."""
        kept = None if self.state is None else motion.restarted(self.state)
        super().start()
        self.state, self.follower, self.path = kept, None, None
        self.slow.reset()

    def act(self, tick):
        """One tick."""
        measured, reference = self.sample.joint_position, self.reference
        if self.follower is None:
            self.follower = TrajectoryFollower(self.joint_names, self.dt, measured, tick, self.blend_time)
        self._check_reference(measured, tick)
        path, self.path = self.path, None
        if path is not None:
            if path.start_tick < tick or not self.slow.at_rest:  # made for a reference that is not there any more
                self.late_goals += 1
            else:
                self.follower.accept(path, tick)
        degraded = self.controller_mode == "DEGRADED"
        slowly = degraded or not self.slow.at_rest
        if slowly:
            self.slow.step(degraded)
        place = reference.array[: 3 * measured.size]
        self.follower.sample(tick - self.slow.lag if slowly else tick, place)
        if slowly:
            self.slow.scale(reference)
            if self.slow.rate == 1.0:  # the path itself is put off by what was lost
                self.follower.delay(self.slow.lag)
                self.slow.reset()
        self.advance()
        self.tick = tick

    def _check_reference(self, measured, tick):
        """Drops the goal when a joint does not follow any more, or on a reset: the reference becomes its position."""
        path_time = tick - self.slow.lag
        lost = self.tick >= 0 and bool(np.any(np.abs(self.reference.desired_position - measured) > LOST_TOLERANCE))
        if self.controller_mode in ("STOPPING", "HOLDING", "STOPPED") and self.follower.moving(path_time):
            lost = True
        if (lost or self.reset_asked) and np.isfinite(measured).all():
            self.aborted_goals += int(self.follower.moving(path_time))
            self.follower.hold(measured, tick)
            self.slow.reset()
            self.resets += int(self.reset_asked)
            self.reset_asked = False


# ---- The torque law with its monitors and the guard behind it ----------------------------------------------------


class TorqueStage(Stage):
    """Torque law and guard. `low`, `high` (n,) rad and `speed` (n,) rad/s: limits of its joints.

    `failed`: something else in the process has thrown; until the robot is stopped the command is none.
    """

    def __init__(self, params, dt, joint_names, limits, low, high, speed):
        super().__init__(torque, params, dt)
        n = params.joints
        self.joint_names, self.limits, self.guard = joint_names, limits, Guard(limits, low, high, speed, dt)
        self.degraded_samples, self.lost, self.warm, self.railed = 0, 0.0, 0, np.zeros(n)
        self.adaptation, self.allowed = loop_monitors_law.initial(n), np.zeros(n)
        self.failed, self.faults, self.gate_open = False, FaultLog(), False
        self.input_ticks = np.full(4, -1.0)
        self._forget_sent()
        self.reset_asked, self.resets, self.refused = False, 0, []

    def start(self):
        """Estimates and a latched stop survive, the filters fill again; parameters go on from where they are."""
        kept, before = self.state, self.params
        super().start()
        if kept is not None:
            self.state, self.params, self.taken = torque.restarted(kept), before, before
        self.guard.deactivate()
        self.gate_open, self.warm = False, 0
        self._forget_sent()
        self.adaptation = loop_monitors_law.initial(self.sample.joints)

    @property
    def mode(self):
        """INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING or STOPPED."""
        mode = self.guard.mode
        if mode == ACTIVE and self.degraded_samples > 0:
            return "DEGRADED"
        return ("INACTIVE", "ACTIVE", "STOPPING", "HOLDING", "STOPPED")[mode]

    @property
    def cause(self):
        """What the latched stop is due to."""
        return EXCEPTION if self.failed else self.faults.first_stop

    def act(self, tick):
        """One tick."""
        demands = self._monitor(tick)
        estimates = None
        still = self.degraded_samples > 0 or self.idle > IDLE_TICKS
        if still and self.state is not None and self.state.layout.name == "TorqueState":
            estimates = {name: self.state.view(name).copy() for name in loop_monitors_law.ESTIMATES}
        self.advance()
        for name, values in (estimates or {}).items():
            self.state.view(name)[:] = values
        command = self._checked(self.output.motor_torque)
        if self.failed and not self.guard.stopped:
            command = np.full(command.size, np.nan)
        self._through_guard(tick, command, demands)

    def act_without(self, tick):
        """One tick in which the law gives nothing."""
        self._through_guard(tick, np.full(self.sample.joints, np.nan), self._monitor(tick))

    def _monitor(self, tick):
        """Lost ticks, gauge and adaptation; counts how long the robot stays degraded."""
        gap, found = tick - self.tick - 1 if self.tick >= 0 else 0, []
        if self.warm >= WARM_TICKS:
            self.lost, found = loop_monitors_law.lost_ticks(gap, self.lost, self.limits)
        else:
            self.warm, self.lost = 0 if gap > 0 else self.warm + 1, 0.0
        self.railed, more = loop_monitors_law.gauge_rail(self.sample.joint_torque, self.railed, self.limits.guard)
        found += more
        if tick % WATCH_TICKS == 0 and self.state is not None and self.state.layout.name == "TorqueState":
            self.adaptation, more = loop_monitors_law.watch(
                self.adaptation, self.state, self.params, self.sample, self.reference, self.limits.guard,
                WATCH_TICKS * self.dt,
            )  # fmt: skip
            found += more
        found += self._obedience()
        self.idle = self.idle + 1 if not np.any(self.sample.motor_torque != 0.0) else 0
        if found and strongest(found) >= Action.DEGRADE:
            self.degraded_samples = int(self.limits.guard.recover_samples)
        elif self.degraded_samples > 0:
            self.degraded_samples -= 1
        return found

    def _forget_sent(self):
        self.sent, self.disobeyed = [np.zeros(self.sample.joints)] * SENT, np.zeros(self.sample.joints)
        self.idle = 0

    def _obedience(self):
        """The drive applies nothing, or one of the last commands, or what somebody else has sent."""
        found, limits = [], self.limits.gate
        for j, u in enumerate(self.sample.motor_torque.tolist()):
            near = OBEYED_SHARE * float(limits.torque_limit[j]) + OBEYED_PART * abs(u)
            ours = u == 0.0 or not np.isfinite(u) or any(abs(u - float(sent[j])) <= near for sent in self.sent)
            self.disobeyed[j] = 0.0 if ours else self.disobeyed[j] + 1.0
            if self.disobeyed[j] >= limits.age_limit:
                found.append(Fault(FaultCode.NOT_OBEYED, j, u, float(self.allowed[j]), Action.DEGRADE))
        return found

    def _checked(self, command):
        """The command; not a number for joints with an input that is not finite, which a law might clip."""
        n = command.size
        used = self.sample.array[: self.sample.layout.slices["motor_torque"].start]
        finite = np.isfinite(used.reshape(-1, n)).all(axis=0)
        finite &= np.isfinite(self.reference.array.reshape(-1, n)).all(axis=0)
        return np.where(finite, command, np.nan)

    def _through_guard(self, tick, command, demands):
        """The last step before publishing. The gate opens with the torque that the drive holds."""
        self.tick, n, seen = tick, command.size, self.guard.measured
        if not self.gate_open:
            self.guard.activate(self.sample.motor_torque)
            self.gate_open = True
        for name in ("motor_position", "motor_velocity", "joint_position", "joint_velocity"):
            seen.view(name)[:] = self.sample.view(name)
        if self.reset_asked:
            self._answer_reset()
        ages = np.full(n, self._input_age(float(tick)))
        self.allowed, self.found = self.guard.step(command, ages, np.full(n, float(tick)), demands)
        self.sent = [*self.sent[1:], self.allowed.copy()]
        self.faults.note(self.found, tick)

    def _input_age(self, tick):
        """Samples since the oldest input was there, negative if one is of a later tick; one not seen yet has none.

        The first ticks of an activation may be late.
        """
        ages = tick - self.input_ticks[~np.isnan(self.input_ticks)]
        ahead = ages[ages < 0.0]
        oldest = max([0.0, *ages]) if self.warm >= WARM_TICKS else 0.0
        return ahead[0] if ahead.size else oldest

    def _answer_reset(self):
        """Refused too while a goal runs, or the reference is not where the joint is."""
        reasons = []
        for j, name in enumerate(self.joint_names):
            if not self.reference.desired_velocity[j] == 0.0:
                reasons.append(f"{name}: a goal is active; reset the motion law first")
            gap = float(self.reference.desired_position[j] - self.sample.joint_position[j])
            if not abs(gap) <= REFERENCE_TOLERANCE:
                where = f"reference {gap:.4g} rad from the joint, limit {REFERENCE_TOLERANCE:g} rad"
                reasons.append(f"{name}: {where}; reset the motion law first")
        self.refused = self.guard.reset(reasons)
        if not self.refused:
            self.failed = False
            self.faults.clear()
            if self.state is not None:
                self.state = torque.restarted(self.state)
        self.reset_asked, self.resets = False, self.resets + 1
