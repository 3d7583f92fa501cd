// Piecewise polynomials of degree up to five through the points of a goal: build, evaluate, exact extrema.
//
// Knots are in samples (integers when a point falls on a sample, which makes the values there exact), coefficients in
// SI: q(t) = c0 + c1 t + ... + c5 t^5, t in s from the segment's start. Layout: [segment][joint][6].
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace hd {

struct Spline {
    int joints;
    std::size_t segments;
    const double* knots;
    const double* coefficients;
};

// Polynomial of `degree` at t, Horner.
inline double polynomial(const double* c, int degree, double t) {
    double value = c[degree];
    for (int i = degree - 1; i >= 0; --i) value = value * t + c[i];
    return value;
}

inline void derivative(const double* c, int degree, double* found) {
    for (int i = 1; i <= degree; ++i) found[i - 1] = i * c[i];
}

// One segment of length t between two states. order 1 uses positions, 3 also velocities, 5 also accelerations.
inline void hermite_segment(int order, double t, double q0, double q1, double v0, double v1, double a0, double a1,
                            double* c) {
    const double d = q1 - q0;
    c[0] = q0;
    c[1] = order >= 3 ? v0 : d / t;
    c[2] = c[3] = c[4] = c[5] = 0.0;
    if (order == 3) {
        c[2] = (3.0 * d / t - 2.0 * v0 - v1) / t;
        c[3] = (v0 + v1 - 2.0 * d / t) / (t * t);
    } else if (order == 5) {
        const double t2 = t * t, t3 = t2 * t;
        c[2] = 0.5 * a0;
        c[3] = (20.0 * d - (8.0 * v1 + 12.0 * v0) * t - (3.0 * a0 - a1) * t2) / (2.0 * t3);
        c[4] = (-30.0 * d + (14.0 * v1 + 16.0 * v0) * t + (3.0 * a0 - 2.0 * a1) * t2) / (2.0 * t2 * t2);
        c[5] = (12.0 * d - 6.0 * (v1 + v0) * t + (a1 - a0) * t2) / (2.0 * t3 * t2);
    }
}

// Coefficients of all segments; q, v, a are (points, joints), null where the order does not use them.
inline void hermite(int order, std::size_t points, int joints, const double* knots, double dt, const double* q,
                    const double* v, const double* a, double* coefficients) {
    for (std::size_t s = 0; s + 1 < points; ++s) {
        const double t = (knots[s + 1] - knots[s]) * dt;
        for (int j = 0; j < joints; ++j) {
            const std::size_t i = s * joints + j, k = i + joints;
            hermite_segment(order, t, q[i], q[k], v ? v[i] : 0.0, v ? v[k] : 0.0, a ? a[i] : 0.0, a ? a[k] : 0.0,
                            coefficients + 6 * i);
        }
    }
}

// Position, velocity, acceleration (3 * joints) at `tick` samples. `cursor` is the last segment used; the new one is
// returned, so that a run through the spline costs the same at every sample. Outside the knots the ends extend.
inline std::size_t evaluate(const Spline& spline, double tick, double dt, std::size_t cursor, double* out) {
    const double *first = spline.knots, *last = spline.knots + spline.segments;
    std::size_t s = std::min(cursor, spline.segments - 1);
    const bool near = first[s] <= tick && (s + 2 > spline.segments || tick < first[std::min(s + 2, spline.segments)]);
    if (near) {
        if (s + 1 < spline.segments && tick >= first[s + 1]) ++s;
    } else {
        const double* above = std::upper_bound(first, last, tick);
        s = above == first ? 0 : static_cast<std::size_t>(above - first) - 1;
    }
    const double t = (tick - first[s]) * dt;
    const int n = spline.joints;
    for (int j = 0; j < n; ++j) {
        const double* c = spline.coefficients + 6 * (s * n + j);
        double rate[5], second[4];
        derivative(c, 5, rate);
        derivative(rate, 4, second);
        out[j] = polynomial(c, 5, t);
        out[n + j] = polynomial(rate, 4, t);
        out[2 * n + j] = polynomial(second, 3, t);
    }
    return s;
}

// A root of c in [low, high], where c changes sign and is monotone: Newton kept inside the bracket by bisection.
inline double bracketed_root(const double* c, const double* slope, int degree, double low, double high) {
    const bool rising = polynomial(c, degree, low) < 0.0;
    double t = 0.5 * (low + high);
    for (int i = 0; i < 60; ++i) {
        const double value = polynomial(c, degree, t);
        if (value == 0.0) break;
        ((value < 0.0) == rising ? low : high) = t;
        const double step = t - value / polynomial(slope, degree - 1, t);
        const double next = step > low && step < high ? step : 0.5 * (low + high);
        if (std::fabs(next - t) <= 1e-13 * high || next == t) break;
        t = next;
    }
    return t;
}

// Extrema of polynomials, one level per derivative: the roots of a derivative split [0, t] into monotone pieces.
struct Turns {
    double at[8];
    int count = 0;
};

inline void widen(double value, double& low, double& high) {
    low = std::min(low, value);
    high = std::max(high, value);
}

// Roots in (0, t) of c (with slope its derivative), given the roots of slope.
inline Turns roots_between(const double* c, const double* slope, int degree, const Turns& slope_roots, double t) {
    Turns found;
    double left = 0.0;
    for (int i = 0; i <= slope_roots.count; ++i) {
        const double right = i < slope_roots.count ? slope_roots.at[i] : t;
        const double from = polynomial(c, degree, left), to = polynomial(c, degree, right);
        if (from * to < 0.0)
            found.at[found.count++] = bracketed_root(c, slope, degree, left, right);
        else if (to == 0.0 && right < t)
            found.at[found.count++] = right;
        left = right;
    }
    return found;
}

// out: lowest and highest position, velocity and acceleration (6 numbers) of one segment of length t.
inline void segment_extrema(const double* c, double t, double* out) {
    double rate[5], second[4], third[3], fourth[2];
    derivative(c, 5, rate);
    derivative(rate, 4, second);
    derivative(second, 3, third);
    derivative(third, 2, fourth);
    Turns turn;
    if (fourth[1] != 0.0) {
        const double vertex = -fourth[0] / fourth[1];
        if (vertex > 0.0 && vertex < t) turn.at[turn.count++] = vertex;
    }
    const double* levels[4] = {second, rate, c, nullptr};
    const Turns third_roots = roots_between(third, fourth, 2, turn, t);
    const Turns second_roots = roots_between(second, third, 3, third_roots, t);
    const Turns rate_roots = roots_between(rate, second, 4, second_roots, t);
    const Turns* turns[3] = {&third_roots, &second_roots, &rate_roots};
    for (int level = 0; level < 3; ++level) {
        const int degree = 3 + level;
        double &low = out[2 * (2 - level)], &high = out[2 * (2 - level) + 1];
        low = high = levels[level][0];
        widen(polynomial(levels[level], degree, t), low, high);
        for (int i = 0; i < turns[level]->count; ++i) {
            widen(polynomial(levels[level], degree, turns[level]->at[i]), low, high);
        }
    }
}

inline void extrema(const Spline& spline, double dt, double* out) {
    for (std::size_t s = 0; s < spline.segments; ++s) {
        const double t = (spline.knots[s + 1] - spline.knots[s]) * dt;
        for (int j = 0; j < spline.joints; ++j) {
            const std::size_t i = s * spline.joints + j;
            segment_extrema(spline.coefficients + 6 * i, t, out + 6 * i);
        }
    }
}

}  // namespace hd
