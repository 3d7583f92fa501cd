// The safety layer: gate, arithmetic of the sensor monitors, the guard's look at an ordinary sample.
#pragma once

#include <cmath>

#include "blocks.hpp"
#include "fault_rows.hpp"

namespace hd {

// The gate of one sample; what it does and why: hd_control/safety/gate.py, docs/equations/safety_gate.md. The tests
// hold it against a plain re-statement, test/oracles/gate_law.py, bit for bit.

#define HD_GATE_LIMITS(FIELD)                                                                            \
    FIELD(age_limit, 0, "samples", "inputs of this age stop the robot", whole(1, 1000))                  \
    FIELD(rate_excess_limit, 0, "samples", "rate excesses in a row that stop the robot", whole(1, 1000)) \
    FIELD(reset_samples, 0, "samples", "healthy samples in a row before a reset", whole(2, 1e6))         \
    FIELD(standstill_velocity, 0, "rad/s", "a faster joint refuses a reset", above(0.0, 0.1))            \
    FIELD(torque_limit, 1, "N m", "largest motor torque, output side", above(0.0))                       \
    FIELD(torque_step, 1, "N m", "largest change of motor torque from sample to sample")

#define HD_GATE_STATE(FIELD)                                                                 \
    FIELD(active, 0, "-", "1: torque may leave")                                             \
    FIELD(stopped, 0, "-", "1: latched stop, torque ramps to zero")                          \
    FIELD(brake_requested, 0, "-", "1 from the sample of the stop until the reset")          \
    FIELD(stop_code, 0, "-", "fault code of the stop, 0 if none")                            \
    FIELD(stop_joint, 0, "-", "joint index of the stop, -1 if none")                         \
    FIELD(healthy_samples, 0, "samples", "healthy samples in a row")                         \
    FIELD(last_torque, 1, "N m", "last torque that left the gate")                           \
    FIELD(last_tick, 1, "-", "tick number of the last command used")                         \
    FIELD(rate_excess_run, 1, "samples", "rate excesses in a row")                           \
    FIELD(catch_up, 1, "samples", "samples left to reach the law after activation or reset") \
    FIELD(saturated_samples, 1, "samples", "samples limited in size since the start")        \
    FIELD(rate_limited_samples, 1, "samples", "samples limited in rate since the start")

HD_BLOCK(GateLimits, HD_GATE_LIMITS)
HD_BLOCK(GateState, HD_GATE_STATE)

constexpr double kLargestTick = 9007199254740992.0;  // 2^53: above it, ticks are no longer exact
constexpr int kFaultsPerJoint = 6;

struct SafetyGate {
    const GateLimits& limits;
    GateState& state;
    FaultRows& faults;
    const int joints;

    // 1. finite  2. tick  3. age. Returns the first stopping code of the joint, 0 if it is healthy.
    int check_input(double command, double age, double tick, int j, bool emitting) {
        const int action = emitting ? kTorqueRamp : kReport;
        int code = 0;
        if (!(std::fabs(command) < INFINITY)) {
            faults.add(kNotFinite, j, command, 0.0, action);
            code = kNotFinite;
        }
        const bool known = 0.0 <= tick && tick <= kLargestTick;
        const bool advances = known && tick > state.last_tick[j];
        if (!advances) {
            faults.add(kStampStuck, j, tick, state.last_tick[j], action);
            if (code == 0) code = kStampStuck;
        }
        if (advances || (known && !emitting)) state.last_tick[j] = tick;
        if (!(0.0 <= age && age < limits.age_limit[0])) {
            faults.add(kNodeKilled, j, age, limits.age_limit[0], action);
            if (code == 0) code = kNodeKilled;
        }
        return code;
    }

    void stop(int code, int j) {
        if (state.stopped[0] != 0.0) return;
        state.stopped[0] = 1.0;
        state.brake_requested[0] = 1.0;
        state.stop_code[0] = code;
        state.stop_joint[0] = j;
    }

    // The last torque as a reference for the rate: bounded whatever the memory holds.
    double reference(int j) const {
        const double last = state.last_torque[j], limit = limits.torque_limit[j];
        if (-limit <= last && last <= limit) return last;
        return last > limit ? limit : (last < -limit ? -limit : 0.0);
    }

    double limit_command(double u, int j, double& run) {
        const double limit = limits.torque_limit[j], last = reference(j);
        if (!(-limit <= u && u <= limit)) {
            faults.add(kTorqueLimited, j, u, limit, kReport);
            state.saturated_samples[j] += 1.0;
            u = u > 0.0 ? limit : -limit;
        }
        const double low = last - limits.torque_step[j], high = last + limits.torque_step[j];
        if (low <= u && u <= high) {
            run = 0.0;
            state.catch_up[j] = 0.0;
            return u;
        }
        faults.add(kRateLimited, j, u - last, limits.torque_step[j], kReport);
        state.rate_limited_samples[j] += 1.0;
        if (state.catch_up[j] > 0.0) {
            state.catch_up[j] -= 1.0;
        } else {
            run += 1.0;
        }
        return u > high ? high : low;
    }

    double ramp(int j) const {
        const double last = reference(j), step = limits.torque_step[j];
        return last > step ? last - step : (last < -step ? last + step : 0.0);
    }

    void run(const double* command, const double* ages, const double* ticks, double* out) {
        bool healthy = true;
        const bool active = state.active[0] != 0.0;
        const bool emitting = active && state.stopped[0] == 0.0;
        for (int j = 0; j < joints; ++j) {
            const int code = check_input(command[j], ages[j], ticks[j], j, emitting);
            healthy = healthy && code == 0;
            if (code != 0 && active) stop(code, j);
        }
        state.healthy_samples[0] = healthy ? state.healthy_samples[0] + 1.0 : 0.0;
        if (active && state.stopped[0] == 0.0) limit_all(command, out);
        for (int j = 0; j < joints; ++j) {
            if (!active) out[j] = 0.0;
            if (active && state.stopped[0] != 0.0) out[j] = ramp(j);
        }
        for (int j = 0; j < joints; ++j) state.last_torque[j] = out[j];
    }

    void limit_all(const double* command, double* out) {
        for (int j = 0; j < joints; ++j) {
            out[j] = limit_command(command[j], j, state.rate_excess_run[j]);
            if (!(state.rate_excess_run[j] < limits.rate_excess_limit[0])) {
                faults.add(kRatePersistent, j, state.rate_excess_run[j], limits.rate_excess_limit[0], kTorqueRamp);
                stop(kRatePersistent, j);
            }
        }
    }
};

// Arithmetic of the sensor monitors and the guard's look at an ordinary sample, for all joints in one call.
//
// Each function answers `true` when there is nothing to report. The callers
// (sensor_watch.hpp, guard.hpp) say what the numbers mean and judge every other sample. Comparisons are written so that a
// NaN is never ordinary.

inline bool all_finite(const double* values, int count) {
    bool good = true;
    for (int i = 0; i < count; ++i) good &= std::fabs(values[i]) < INFINITY;
    return good;
}

inline bool all_below(const double* values, const double* limit, int count) {
    bool good = true;
    for (int i = 0; i < count; ++i) good &= std::fabs(values[i]) < limit[i];
    return good;
}

inline bool all_near(const double* a, const double* b, const double* limit, int count) {
    bool good = true;
    for (int i = 0; i < count; ++i) good &= std::fabs(a[i] - b[i]) <= limit[i];
    return good;
}

// The difference of two readings of a counter that wraps at `period`; 0: it does not.
inline double modular(double difference, double period) {
    return period > 0.0 ? difference - period * std::nearbyint(difference / period) : difference;
}

// Is every reading within `limit` of the prediction last + slope? Writes the new slope. `period` may be null.
inline bool readings_follow(const double* reading, const double* last, const double* slope, const double* limit,
                            const double* period, double* new_slope, int count) {
    bool good = true;
    for (int i = 0; i < count; ++i) {
        const double wrap = period == nullptr ? 0.0 : period[i];
        good &= std::fabs(modular(reading[i] - (last[i] + slope[i]), wrap)) <= limit[i];
        new_slope[i] = modular(reading[i] - last[i], wrap);
    }
    return good;
}

// Integrals of residual, residual cos 2 beta, residual sin 2 beta (trapezoids) and of the length over the way of the
// motor shaft. Rows of terms: 3, of sums: 4. Ordinary: no whole turn, no detour, no step that is too long.
struct TurnLimits {
    double whole, longest_way, largest_step;
};

inline bool sum_turn(const double* residual, const double* shaft, const double* gauge_angle, const double* last_shaft,
                     const double* last_terms, const double* last_sums, const double* last_travel,
                     const TurnLimits& limits, double* terms, double* sums, double* travel, int joints) {
    bool ordinary = true;
    for (int j = 0; j < joints; ++j) {
        const double step = shaft[j] - last_shaft[j], twice = 2.0 * gauge_angle[j];
        const double now[3] = {residual[j], residual[j] * std::cos(twice), residual[j] * std::sin(twice)};
        for (int row = 0; row < 3; ++row) {
            const int at = row * joints + j;
            const double before = std::isnan(last_terms[at]) ? now[row] : last_terms[at];
            terms[at] = now[row];
            sums[at] = last_sums[at] + 0.5 * (before + now[row]) * step;
        }
        const int length = 3 * joints + j;
        sums[length] = last_sums[length] + std::fabs(step);
        travel[j] = last_travel[j] + step;
        ordinary &= std::fabs(travel[j]) < limits.whole && sums[length] <= limits.longest_way &&
                    std::fabs(step) <= limits.largest_step;
    }
    return ordinary;
}

// Memory of the stuck monitor, rows encoder and resolver.
struct StuckMemory {
    const double *reading, *repeats, *expected, *other;
};

// Motion that a sensor missed while it repeated one reading; ordinary: nowhere above the limit.
inline bool missed_motion(const double* positions, const double* twist, const StuckMemory& memory, double samples,
                          const double* limit, double step, double* repeats, double* expected, double* other,
                          double* moved, int joints) {
    bool ordinary = true;
    for (int i = 0; i < 2 * joints; ++i) {
        const bool encoder = i < joints;
        const int j = encoder ? i : i - joints;
        const double partner = positions[encoder ? i + joints : j];
        const double now = encoder ? partner + twist[j] : partner - twist[j];
        const bool same = positions[i] == memory.reading[i];
        repeats[i] = same ? memory.repeats[i] + step : 0.0;
        expected[i] = same && std::isfinite(memory.expected[i]) ? memory.expected[i] : now;
        other[i] = same ? memory.other[i] : partner;
        const double a = std::fabs(now - expected[i]), b = std::fabs(partner - other[i]);
        const double least = std::isnan(a) || std::isnan(b) ? NAN : (a < b ? a : b);
        moved[i] = repeats[i] >= samples ? least : 0.0;
        ordinary &= !(moved[i] > limit[j]);
    }
    return ordinary;
}

// Repetitions of a gauge reading and where the motor was when they began; ordinary: no motion above `limit` meanwhile,
// or fewer than `samples` of them.
inline bool gauge_changes(const double* gauge, const double* position, const double* reading, const double* before,
                          const double* start_before, const double* limit, double samples, double* repeats,
                          double* start, int joints) {
    bool ordinary = true;
    for (int j = 0; j < joints; ++j) {
        const bool same = gauge[j] == reading[j];
        repeats[j] = same ? before[j] + 1.0 : 0.0;
        start[j] = same ? start_before[j] : position[j];
        ordinary &= !(std::fabs(position[j] - start[j]) > limit[j] && repeats[j] >= samples);
    }
    return ordinary;
}

// What the guard looks at: (n,) each.
struct GuardLook {
    const double *command, *ages, *ticks, *last_tick, *position, *velocity, *low, *high, *speed, *twice_deceleration;
    double age_limit, largest_tick;
};

// Inputs finite, young and newer than the last; no joint too fast; every joint could still stop inside its limits.
inline bool guard_is_quiet(const GuardLook& look, int joints) {
    bool quiet = true;
    for (int j = 0; j < joints; ++j) {
        const double v = look.velocity[j], end = look.position[j] + v * std::fabs(v) / look.twice_deceleration[j];
        quiet &= std::fabs(look.command[j]) < INFINITY && look.ticks[j] > look.last_tick[j] &&
                 look.ticks[j] <= look.largest_tick && look.ages[j] >= 0.0 && look.ages[j] < look.age_limit &&
                 look.low[j] <= end && end <= look.high[j] && std::fabs(v) <= look.speed[j];
    }
    return quiet;
}

}  // namespace hd
