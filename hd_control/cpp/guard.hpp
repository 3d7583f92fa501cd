// Guard: the safety gate with a controlled stop in front of it, and the monitors around the torque law.
//
//     command -> inputs healthy? -> envelope -> strongest action -> law's torque | stop torque | ramp -> safety gate
//
// Controlled stop (action A2) on the motor side, then hold:
//     v_r falls from the present velocity to 0 at stop_deceleration, x_r is its integral;
//     u = hold_torque - stop_damping (v - v_r) - stop_stiffness (x - x_r)
// `hold_torque` is the mean torque of the last 50 samples, so it carries the weight of the arm without any model.
//
// The same object stands on both sides of the wire. No clock, no allocation, no exception for any number; what is found
// leaves as rows. docs/equations/safety_gate.md, docs/safety.md. This is not a certified safety function.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "blocks.hpp"
#include "fault_rows.hpp"
#include "safety.hpp"

namespace hd {

#define HD_GUARD_STATE(FIELD)                                                           \
    FIELD(controlled, 0, "-", "1: a controlled stop runs or holds")                     \
    FIELD(emitting, 0, "-", "1: the law's torque leaves")                               \
    FIELD(healthy, 0, "samples", "samples in a row without a fault that stops")         \
    FIELD(mean_torque, 1, "N m", "mean of the torque that left, over about 50 samples") \
    FIELD(last_tick, 1, "-", "tick of the last command looked at")

#define HD_STOP_STATE(FIELD)                                     \
    FIELD(elapsed, 0, "samples", "samples since the stop began") \
    FIELD(hold_torque, 1, "N m", "mean torque before the stop")  \
    FIELD(reference_position, 1, "rad", "x_r")                   \
    FIELD(reference_velocity, 1, "rad/s", "v_r")                 \
    FIELD(first_speed, 1, "rad/s", "speed when the stop began")

#define HD_GUARD_MEASURED(FIELD)                \
    FIELD(motor_position, 1, "rad", "phi")      \
    FIELD(motor_velocity, 1, "rad/s", "D(phi)") \
    FIELD(joint_position, 1, "rad", "q")        \
    FIELD(joint_velocity, 1, "rad/s", "D(q)")

#define HD_GUARD_LIMITS(FIELD)                                                                                        \
    FIELD(degrade_gap_samples, 0, "samples", "lost ticks in a row that freeze the adaptation", whole(1, 1e6))         \
    FIELD(recover_samples, 0, "samples", "healthy samples in a row that end it", whole(1, 1e6))                       \
    FIELD(brake_samples, 0, "samples", "longest hold of the drive side while the brakes close", whole(1, 1e6))        \
    FIELD(rejected_samples, 0, "samples", "bad readings in a row that stop the robot", whole(1, 1e6))                 \
    FIELD(disagree_samples, 0, "samples", "samples of disagreeing sensors that stop the robot", whole(1, 1e6))        \
    FIELD(frozen_samples, 0, "samples", "equal readings in motion that stop the robot", whole(1, 1e6))                \
    FIELD(rail_degrade_samples, 0, "samples", "gauge readings at the rail that freeze the adaptation", whole(1, 1e6)) \
    FIELD(rail_samples, 0, "samples", "gauge readings at the rail that stop the robot", whole(1, 1e6))                \
    FIELD(adaptation_time, 0, "s", "time at a bound before a growing error counts", between(0.01, 1e3))               \
    FIELD(motor_temperature_low, 0, "degC", "a lower motor temperature is no reading", between(-273.15, 100.0))       \
    FIELD(motor_temperature_high, 0, "degC", "a higher motor temperature is no reading", between(0.0, 1000.0))        \
    FIELD(motor_temperature_rate, 0, "K/s", "fastest change of a motor temperature", above(0.0))                      \
    FIELD(carry_tolerance, 1, "N m", "a brake opens while the gauge is this near to the command", above(0.0))        \
    FIELD(stop_deceleration, 1, "rad/s^2", "of a controlled stop", above(0.0))                                        \
    FIELD(stop_damping, 1, "N m s/rad", "of a controlled stop, on the motor side", above(0.0))                        \
    FIELD(stop_stiffness, 1, "N m/rad", "of the hold after a controlled stop, on the motor side", above(0.0))         \
    FIELD(position_step_limit, 1, "rad", "largest jump of a position reading against its prediction", above(0.0))     \
    FIELD(gauge_step_limit, 1, "N m", "largest jump of a gauge reading against its prediction", above(0.0))           \
    FIELD(gauge_rail, 1, "N m", "a larger gauge reading is at its rail", above(0.0))                                  \
    FIELD(twist_limit, 1, "rad", "largest difference of motor and joint position", above(0.0))                        \
    FIELD(stuck_motion_limit, 1, "rad", "motion that the others show while a position sensor repeats one reading",    \
          above(0.0))                                                                                                 \
    FIELD(residual_limit, 1, "N m", "largest mean residual of the three sensors over a motor turn", above(0.0))       \
    FIELD(ripple_limit, 1, "N m", "largest 2 beta amplitude of that residual", above(0.0))

HD_BLOCK(GuardState, HD_GUARD_STATE)
HD_BLOCK(StopState, HD_STOP_STATE)
HD_BLOCK(GuardMeasured, HD_GUARD_MEASURED)
HD_BLOCK(GuardLimits, HD_GUARD_LIMITS)

constexpr double kMeanSamples = 50.0;
// rad/s; a joint that becomes faster than at the begin of the stop by more than this has left the stop. The filter of
// the velocity lags by 5 ms, in which a wrong torque near the limit adds as much.
constexpr double kSpeedMargin = 0.3;
constexpr double kSpeedShare = 1.2;     // a joint faster than this share of its velocity limit is stopped
constexpr double kOutwardSpeed = 0.05;  // rad/s; slower motion outside the envelope is noise, or the way back

// One row of a refused reset; Python makes the words.
enum RefusalKind { kNotHealthy = 1, kMoves = 2, kRampRuns = 3, kGoalActive = 4, kReferenceAway = 5 };

class Guard {
  public:
    // `bounds`: rows low, high (rad), speed (rad/s), each n. `hold_samples` 0: a controlled stop holds without end.
    Guard(const double* gate_limits, const double* guard_limits, const double* bounds, int joints, double dt,
          double hold_samples)
        : n(joints),
          dt(dt),
          hold_samples(hold_samples),
          gate_limits_(gate_limits, gate_limits + GateLimits::size(joints)),
          guard_limits_(guard_limits, guard_limits + GuardLimits::size(joints)),
          bounds_(bounds, bounds + 3 * joints),
          gate_state(GateState::size(joints), 0.0),
          guard_state(GuardState::size(joints), 0.0),
          stop_state(StopState::size(joints), 0.0),
          measured(GuardMeasured::size(joints), 0.0),
          gate_before_(gate_state.size()),
          twice_(joints),
          no_age_(joints, 0.0),
          ticks_(joints),
          stop_torque_(joints),
          rows_(static_cast<std::size_t>(kFaultFields) * kGuardRows(joints)),
          gate_rows_(static_cast<std::size_t>(kFaultFields) * kFaultsPerJoint * joints),
          limits(gate_limits_.data(), joints),
          guard_limits(guard_limits_.data(), joints),
          gate(gate_state.data(), joints),
          state(guard_state.data(), joints),
          stop(stop_state.data(), joints),
          seen(measured.data(), joints) {
        gate.stop_joint[0] = -1.0;
        for (int j = 0; j < n; ++j) {
            gate.last_tick[j] = state.last_tick[j] = -1.0;
            bounds_[static_cast<std::size_t>(2 * n + j)] *= kSpeedShare;
            twice_[static_cast<std::size_t>(j)] = 2.0 * this->guard_limits.stop_deceleration[j];
        }
        found_.rows = rows_.data();
        found_.capacity = kGuardRows(joints);
    }
    Guard(const Guard&) = delete;
    Guard& operator=(const Guard&) = delete;

    static int kGuardRows(int joints) { return 24 * joints + 16; }

    bool stopped() const { return !emitting() && (controlled() || gate.stopped[0] != 0.0); }
    bool emitting() const { return state.emitting[0] != 0.0; }
    bool controlled() const { return state.controlled[0] != 0.0; }
    bool resting() const {
        for (int j = 0; j < n; ++j)
            if (stop.reference_velocity[j] != 0.0) return false;
        return true;
    }
    // INACTIVE 0, ACTIVE 1, STOPPING 2, HOLDING 3, STOPPED 4.
    int mode() const {
        if (emitting()) return 1;
        if (gate.active[0] == 0.0) return 0;
        if (gate.stopped[0] != 0.0) return 4;
        return resting() ? 3 : 2;
    }

    // Opens with the torque (n,) N m that the drive holds now. A latched stop stays latched.
    void activate(const double* applied) {
        open_gate(applied);
        for (int j = 0; j < n; ++j) state.mean_torque[j] = applied[j];
        look();
    }

    // Closed: zero torque from the next sample. A controlled stop ends as a ramp that has ended.
    void deactivate() {
        if (controlled()) stop_by(kStopLeft, -1);
        gate.active[0] = 0.0;
        look();
    }

    // After any change of the state: may the law's torque leave?
    void look() { state.emitting[0] = !controlled() && gate.active[0] != 0.0 && gate.stopped[0] == 0.0 ? 1.0 : 0.0; }

    // One sample. `ages`, `ticks` (n,); the torque that may leave goes to `out`, findings are added to `faults`.
    // `faults` may hold what the monitors demand: its rows from `first` on are those of this sample.
    void step(const double* command, const double* ages, const double* ticks, double* out, FaultRows& faults,
              int first = 0) {
        if (emitting() && faults.count == first && quiet(command, ages, ticks)) {
            std::copy(gate_state.begin(), gate_state.end(), gate_before_.begin());
            FaultRows nothing{gate_rows_.data(), kFaultsPerJoint * n};
            run_gate(command, ages, ticks, out, nothing);
            if (nothing.count == 0) {
                state.healthy[0] += 1.0;
                follow_mean(out);
                for (int j = 0; j < n; ++j) state.last_tick[j] = ticks[j];
                return;
            }
            std::copy(gate_before_.begin(), gate_before_.end(), gate_state.begin());
        }
        judge(command, ages, ticks, out, faults, first);
    }

    // Ends a latched stop if all is healthy and still, unless the caller has `others` reasons against it. Writes a row
    // (kind, joint, value, limit) for every reason of its own and returns how many; none if there is nothing to end.
    int reset(double* refusals, bool others) {
        if (!stopped()) return 0;
        int count = 0;
        auto refuse = [&](int kind, int joint, double value, double limit) {
            double* row = refusals + 4 * count++;
            row[0] = kind, row[1] = joint, row[2] = value, row[3] = limit;
        };
        if (!(state.healthy[0] >= limits.reset_samples[0]))
            refuse(kNotHealthy, -1, state.healthy[0], limits.reset_samples[0]);
        for (int j = 0; j < n; ++j) {
            const double velocity = seen.joint_velocity[j], still = limits.standstill_velocity[0];
            if (!(std::fabs(velocity) <= still)) refuse(kMoves, j, velocity, still);
            const double ramp = controlled() ? 0.0 : gate.last_torque[j];
            if (!(ramp == 0.0)) refuse(kRampRuns, j, ramp, 0.0);
        }
        if (others) return count;
        if (count > 0) return count;
        gate.healthy_samples[0] = state.healthy[0];
        gate.stopped[0] = gate.brake_requested[0] = gate.stop_code[0] = 0.0;
        gate.stop_joint[0] = -1.0;
        if (gate.active[0] == 1.0) catch_up();
        for (int j = 0; j < n; ++j) gate.last_tick[j] = state.last_tick[j];
        state.controlled[0] = 0.0;
        look();
        return 0;
    }

    void stop_by(int code, int joint) {
        if (gate.stopped[0] != 0.0) return;
        gate.stopped[0] = gate.brake_requested[0] = 1.0;
        gate.stop_code[0] = code;
        gate.stop_joint[0] = joint;
    }

  private:
    void open_gate(const double* applied) {
        catch_up();
        gate.active[0] = 1.0;
        for (int j = 0; j < n; ++j) gate.last_torque[j] = applied[j];
    }

    // Before a new source of commands: rate excesses count anew, after the time to cross the torque range.
    void catch_up() {
        for (int j = 0; j < n; ++j) {
            gate.rate_excess_run[j] = 0.0;
            gate.catch_up[j] = std::ceil(2.0 * limits.torque_limit[j] / limits.torque_step[j]);
        }
    }

    bool quiet(const double* command, const double* ages, const double* ticks) const {
        const double* bound = bounds_.data();
        const GuardLook what{
            command, ages,      ticks,         state.last_tick, seen.joint_position, seen.joint_velocity,
            bound,   bound + n, bound + 2 * n, twice_.data(),   limits.age_limit[0], kLargestTick};
        return guard_is_quiet(what, n);
    }

    void run_gate(const double* command, const double* ages, const double* ticks, double* out, FaultRows& faults) {
        SafetyGate one{limits, gate, faults, n};
        one.run(command, ages, ticks, out);
    }

    void follow_mean(const double* out) {
        for (int j = 0; j < n; ++j) state.mean_torque[j] += (out[j] - state.mean_torque[j]) / kMeanSamples;
    }

    void judge(const double* command, const double* ages, const double* ticks, double* out, FaultRows& faults,
               int first) {
        const bool was_emitting = emitting();
        found_.count = 0;
        for (int i = first; i < faults.count; ++i) found_.copy(faults, i);
        input_faults(command, ages, ticks);
        if (was_emitting) envelope_faults();
        const int action = found_.strongest();
        state.healthy[0] = action < kControlledStop ? state.healthy[0] + 1.0 : 0.0;
        if (action >= kControlledStop) begin_stop(action);
        FaultRows said{gate_rows_.data(), kFaultsPerJoint * n};
        if (controlled()) {
            controlled_stop(out, said);
        } else {
            through_or_stop(command, ages, ticks, out, said);
            follow_mean(out);
        }
        const int known = found_.count;
        for (int i = 0; i < said.count; ++i)
            if (!found_.has(said.code(i), said.joint(i), known)) found_.copy(said, i);
        for (int j = 0; j < n; ++j) state.last_tick[j] = std::fmax(ticks[j], state.last_tick[j]);
        if (found_.count > 0) look();
        faults.count = first;
        for (int i = 0; i < found_.count; ++i) {
            faults.copy(found_, i);
            if (!was_emitting) faults.set_action(faults.count - 1, kReport);
        }
    }

    // Commands that are not finite, too old, or not newer than the last ones.
    void input_faults(const double* command, const double* ages, const double* ticks) {
        for (int j = 0; j < n; ++j)
            if (!(std::fabs(command[j]) < INFINITY)) found_.add(kNotFinite, j, command[j], 0.0, kControlledStop);
        for (int j = 0; j < n; ++j)
            if (!(ticks[j] > state.last_tick[j] && ticks[j] <= kLargestTick))
                found_.add(kStampStuck, j, ticks[j], state.last_tick[j], kControlledStop);
        for (int j = 0; j < n; ++j)
            if (!(ages[j] >= 0.0 && ages[j] < limits.age_limit[0]))
                found_.add(kNodeKilled, j, ages[j], limits.age_limit[0], kControlledStop);
    }

    // A joint that is too fast, or moves outward and could no longer stop inside: q + v|v| / (2 a) outside.
    void envelope_faults() {
        const double *low = bounds_.data(), *high = low + n, *speed = high + n;
        for (int j = 0; j < n; ++j) {
            const double v = seen.joint_velocity[j];
            if (std::fabs(v) > speed[j] && std::isfinite(v)) found_.add(kOverspeed, j, v, speed[j], kControlledStop);
        }
        for (int j = 0; j < n; ++j) {
            const double v = seen.joint_velocity[j];
            const double end = seen.joint_position[j] + v * std::fabs(v) / twice_[static_cast<std::size_t>(j)];
            const bool outward = (end > high[j] && v > kOutwardSpeed) || (end < low[j] && v < -kOutwardSpeed);
            if (outward) found_.add(kEnvelope, j, end, v > 0.0 ? high[j] : low[j], kControlledStop);
        }
    }

    // Begins what the strongest fault demands; a stop that runs is never replaced by a weaker one.
    void begin_stop(int action) {
        if (gate.active[0] == 0.0 || gate.stopped[0] != 0.0) return;
        const int cause = found_.first_with(action);
        const bool usable = all_finite(seen.motor_position, n) && all_finite(seen.motor_velocity, n);
        if (action >= kTorqueRamp || !usable) {
            stop_by(found_.code(cause), found_.joint(cause));
            state.controlled[0] = 0.0;
        } else if (!controlled()) {
            std::fill(stop_state.begin(), stop_state.end(), 0.0);
            for (int j = 0; j < n; ++j) {
                stop.hold_torque[j] = state.mean_torque[j];
                stop.reference_position[j] = seen.motor_position[j];
                stop.reference_velocity[j] = seen.motor_velocity[j];
                stop.first_speed[j] = std::fabs(seen.motor_velocity[j]);
            }
            state.controlled[0] = 1.0;
            catch_up();
        }
    }

    void controlled_stop(double* out, FaultRows& said) {
        double* torque = stop_torque_.data();
        stop.elapsed[0] += 1.0;
        for (int j = 0; j < n; ++j) {
            const double before = stop.reference_velocity[j];
            const double step = guard_limits.stop_deceleration[j] * dt;
            stop.reference_velocity[j] = std::copysign(std::fmax(std::fabs(before) - step, 0.0), before);
            stop.reference_position[j] = stop.reference_position[j] + stop.reference_velocity[j] * dt;
            const double damping = guard_limits.stop_damping[j] * (seen.motor_velocity[j] - stop.reference_velocity[j]);
            torque[j] = stop.hold_torque[j] - damping -
                        guard_limits.stop_stiffness[j] * (seen.motor_position[j] - stop.reference_position[j]);
        }
        int fast = -1;
        for (int j = n - 1; j >= 0; --j)
            if (!(std::fabs(seen.motor_velocity[j]) <= stop.first_speed[j] + kSpeedMargin)) fast = j;
        if (fast >= 0 || !all_finite(torque, n)) {
            const int joint = std::max(fast, 0);
            found_.add(kStopLeft, joint, seen.motor_velocity[joint], stop.first_speed[joint] + kSpeedMargin,
                       kTorqueRamp);
            stop_by(kStopLeft, joint);
        } else if (0.0 < hold_samples && hold_samples <= stop.elapsed[0]) {
            stop_by(kStopLeft, -1);
        }
        for (int j = 0; j < n; ++j) ticks_[static_cast<std::size_t>(j)] = gate.last_tick[j] + 1.0;
        through(torque, no_age_.data(), ticks_.data(), out, said);
    }

    // The gate, always the last. A stop that it begins itself ends a controlled one.
    void through(const double* command, const double* ages, const double* ticks, double* out, FaultRows& said) {
        said.count = 0;
        run_gate(command, ages, ticks, out, said);
        if (gate.stopped[0] != 0.0) state.controlled[0] = 0.0;
    }

    // The gate; a stop that the gate itself wants becomes a controlled one while that is possible.
    void through_or_stop(const double* command, const double* ages, const double* ticks, double* out, FaultRows& said) {
        std::copy(gate_state.begin(), gate_state.end(), gate_before_.begin());
        const double controlled_before = state.controlled[0];
        through(command, ages, ticks, out, said);
        const int stops = said.first_at_least(kControlledStop);
        if (!(stops >= 0 && emitting() && said.code(stops) == kRatePersistent)) return;
        std::copy(gate_before_.begin(), gate_before_.end(), gate_state.begin());
        state.controlled[0] = controlled_before;
        state.healthy[0] = 0.0;
        for (int i = 0; i < said.count; ++i)
            if (said.action(i) >= kControlledStop) {
                found_.copy(said, i);
                found_.set_action(found_.count - 1, kControlledStop);
            }
        begin_stop(kControlledStop);
        if (controlled())
            controlled_stop(out, said);
        else
            through(command, ages, ticks, out, said);
    }

  public:
    const int n;
    const double dt, hold_samples;

  private:
    std::vector<double> gate_limits_, guard_limits_, bounds_;

  public:
    std::vector<double> gate_state, guard_state, stop_state, measured;

  private:
    std::vector<double> gate_before_, twice_, no_age_, ticks_, stop_torque_, rows_, gate_rows_;
    FaultRows found_{};

  public:
    GateLimits limits;
    GuardLimits guard_limits;
    GateState gate;
    GuardState state;
    StopState stop;
    GuardMeasured seen;
};

// ---------------------------------------------------------------------------------------- around the torque law

constexpr double kForgiven = 0.1;  // share of a lost tick that each tick that comes makes good
constexpr double kRailShare = 0.99;
constexpr double kDegradeGrowth = 2.0, kStopGrowth = 4.0;
constexpr double kSmallestError = 0.01;  // rad; a smaller tracking error is no reason to act, however it grew
constexpr double kErrorSamples = 10.0;

#define HD_ADAPTATION_WATCH(FIELD)                                                 \
    FIELD(error, 1, "rad", "mean tracking error over about 10 looks")              \
    FIELD(time_at_bound, 1, "s", "since an estimate of the joint is at its bound") \
    FIELD(error_at_bound, 1, "rad", "error when that began")

HD_BLOCK(AdaptationWatch, HD_ADAPTATION_WATCH)

// F01: what `gap` lost ticks before this one demand. `level` is what was lost and is not forgiven yet: ten lost in a
// row stop the robot, and so does every second one lost for 25 ticks.
inline double lost_ticks(double gap, double level, const GateLimits& gate, const GuardLimits& limits,
                         FaultRows& faults) {
    level = level > kForgiven ? level - kForgiven : 0.0;
    if (gap <= 0.0) return level;
    level += gap;
    if (level >= gate.age_limit[0])
        faults.add(kFrameLost, -1, level, gate.age_limit[0], kControlledStop);
    else if (gap >= limits.degrade_gap_samples[0])
        faults.add(kFrameLost, -1, level, limits.degrade_gap_samples[0], kDegrade);
    else
        faults.add(kFrameLost, -1, level, 1.0, kReport);
    return level;
}

// F08 as the law sees it: joint torque (n,) at the rail, a few in a row, degrades; fusion stops after more of them.
inline void law_gauge_rail(const double* torque, double* run, const GuardLimits& limits, int n, FaultRows& faults) {
    bool below = true;
    for (int j = 0; j < n; ++j) below &= std::fabs(torque[j]) < kRailShare * limits.gauge_rail[j];
    for (int j = 0; j < n; ++j) {
        const bool free = below || std::fabs(torque[j]) < kRailShare * limits.gauge_rail[j] || std::isnan(torque[j]);
        run[j] = free ? 0.0 : run[j] + 1.0;
        if (!below && run[j] >= limits.rail_degrade_samples[0])
            faults.add(kGaugeRail, j, torque[j], limits.gauge_rail[j], kDegrade);
    }
}

// F34: an estimate at its bound is normal work of the projection; it becomes a fault when it lasts and the error grows.
// Estimates and their bounds: `count` arrays of n each. `dt` s between two looks.
inline void watch_adaptation(AdaptationWatch& memory, const double* const* estimates, const double* const* low,
                             const double* const* high, int count, const double* desired, const double* position,
                             const GuardLimits& limits, int n, double dt, FaultRows& faults) {
    for (int j = 0; j < n; ++j) {
        const double error = std::fabs(desired[j] - position[j]);
        const double mean = memory.error[j] + (std::isfinite(error) ? error - memory.error[j] : 0.0) / kErrorSamples;
        memory.error[j] = mean;
        bool bound = false;
        for (int i = 0; i < count; ++i)
            bound |= (estimates[i][j] <= low[i][j] || estimates[i][j] >= high[i][j]) && low[i][j] < high[i][j];
        if (bound && memory.time_at_bound[j] == 0.0) memory.error_at_bound[j] = mean;
        memory.time_at_bound[j] = bound ? memory.time_at_bound[j] + dt : 0.0;
        if (!(memory.time_at_bound[j] > limits.adaptation_time[0] && mean > kSmallestError)) continue;
        const double growth = mean / std::fmax(memory.error_at_bound[j], kSmallestError / kStopGrowth);
        if (growth >= kDegradeGrowth)
            faults.add(kAdaptation, j, growth, kDegradeGrowth, growth >= kStopGrowth ? kControlledStop : kDegrade);
    }
}

}  // namespace hd
