// Arithmetic of the sensor monitors and the guard's look at an ordinary sample, for all joints in one call.
//
// Each function answers `true` when there is nothing to report. Python (hd_control/safety/sensor_monitors.py,
// stuck_monitor.py, hd_control/safety/guard.py) says what the numbers mean, and judges every sample that is not
// ordinary. Comparisons are written so that a NaN is never ordinary.
#pragma once

#include <cmath>

namespace hd {

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
