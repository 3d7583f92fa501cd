// What several laws share: fields of their parameter blocks; derivative filter D, projection P, sign, kinematic error.
#pragma once

#include <cmath>

#include "blocks.hpp"

namespace hd {

// One parameter of a node, whichever law reads it.
#define HD_DERIVATIVE_CUTOFF(FIELD) \
    FIELD(derivative_cutoff, 0, "rad/s", "cut-off of the derivative filter D", above(0.0, 1e5))
#define HD_RATE_SOURCE(FIELD) \
    FIELD(rate_source, 0, "-", "rates from the measurements, or from the tracking error", one_of("plain error_filter"))
#define HD_GEAR_RATIO(FIELD) FIELD(gear_ratio, 1, "-", "rotor turns per joint turn", above(0.0))
#define HD_TORSIONAL_STIFFNESS(FIELD) \
    FIELD(torsional_stiffness, 1, "N m/rad", "linear stiffness of the drive", above(0.0).times(2.0))
#define HD_ROTOR_INERTIA(FIELD) FIELD(rotor_inertia, 1, "kg m^2", "rotor inertia, output side", above(0.0))
#define HD_LINK_INERTIA(FIELD) \
    FIELD(link_inertia, 1, "kg m^2", "inertia of the link; 0: the link is locked", at_least(0.0))
#define HD_MOTOR_TORQUE_LIMIT(FIELD) \
    FIELD(motor_torque_limit, 1, "N m", "largest motor torque, output side", above(0.0))
#define HD_KINEMATIC_ERROR(FIELD)                                                                                  \
    FIELD(kinematic_cosine, 4, "rad", "kinematic error: factor of cos n theta_m", between(-0.1, 0.1).within(2e-3)) \
    FIELD(kinematic_sine, 4, "rad", "kinematic error: factor of sin n theta_m", between(-0.1, 0.1).within(2e-3))

enum RateSource { kPlain = 0, kErrorFilter = 1 };

// Derivative filter D: cutoff s / (s + cutoff). Zhu, section V; general rates by the pole's exact image.
//
//     D(x)[k] = a D(x)[k-1] + (1 - a) (x[k] - x[k-1]) / dt
//
// Rule for the pole a: the paper's own setting (dt = 1 ms, cutoff = 200 rad/s) uses its literal a = 1 - cutoff dt =
// 0.8; every other setting uses a = exp(-cutoff dt). Group delay at low frequency is a dt / (1 - a) plus half a sample.
// D squared means D applied to the output of D.

// Pole a of the filter for `cutoff` in rad/s and sample time `dt` in s.
inline double derivative_pole(double cutoff, double dt) {
    const bool papers_own = std::fabs(dt - 1e-3) < 1e-12 && std::fabs(cutoff - 200.0) < 1e-9;
    return papers_own ? 0.8 : std::exp(-cutoff * dt);
}

// One sample of D. `last` holds x[k-1] and `rate` holds D(x)[k-1]; both are renewed. Returns D(x)[k].
// Start: last = first sample, rate = 0.
inline double differentiate(double x, double& last, double& rate, double pole, double dt) {
    rate = pole * rate + (1.0 - pole) * ((x - last) / dt);
    last = x;
    return rate;
}

inline double sign(double x) { return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : 0.0); }

// Projection function P: a bounded integrator, the update of every adapted parameter. Zhu (11), (12), (38), (40).
//
//     dP/dt = gain * drive * kappa,   kappa = 0 at a bound that the drive pushes against, else 1
//
// The discrete form below is exact for a drive that is constant over the step. It keeps, for every theta in [low, high]
// and with P the value AFTER the step, (theta - P)(drive - dP / (gain dt)) <= 0, which the stability proof needs.

// x limited to [low, high]. A NaN becomes `low`: a bounded value stays bounded whatever comes in.
inline double clip(double x, double low, double high) { return x >= low ? (x <= high ? x : high) : low; }

// One step of P. `drive` s, `gain` rho, `value` P before the step. Returns P after the step, always inside [low, high].
// A drive that is not a number leaves the value where it is (inside its bounds).
inline double project(double value, double drive, double gain, double low, double high, double dt) {
    if ((value <= low && drive <= 0.0) || (value >= high && drive >= 0.0) || drive != drive) {
        return clip(value, low, high);
    }
    return clip(value + dt * gain * drive, low, high);
}

// Kinematic error of the gear: KE(theta) = sum_n a_n cos(n theta) + b_n sin(n theta), n = 1 .. 4, rad at the output.
// Gandhi-Ghorbel (2). Slope and curvature are derivatives with respect to the rotor angle theta.

constexpr int kHarmonics = 4;  // harmonics of the kinematic error in every block

struct KinematicError {
    double value = 0.0;
    double slope = 0.0;
    double curvature = 0.0;
};

// One sine and one cosine, then angle addition for the higher harmonics.
inline KinematicError kinematic_error(double angle, const double* cosine, const double* sine) {
    const double c1 = std::cos(angle), s1 = std::sin(angle);
    double c = c1, s = s1;
    KinematicError error;
    for (int i = 0; i < kHarmonics; ++i) {
        const double n = i + 1;
        const double in_phase = cosine[i] * c + sine[i] * s;
        error.value += in_phase;
        error.slope += n * (sine[i] * c - cosine[i] * s);
        error.curvature -= n * n * in_phase;
        const double next = c * c1 - s * s1;
        s = s * c1 + c * s1;
        c = next;
    }
    return error;
}

}  // namespace hd
