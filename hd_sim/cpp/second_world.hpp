// The second world: one joint with harmonic drive and link, in laws of its own (docs/second_world.md).
//
// Everything is referred to the output side. One classical Runge-Kutta step of fourth order
// per substep advances motion and all memory (bristles, Bouc-Wen variable, current, gauge filter, temperature)
// together.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "blocks.hpp"

namespace hd_second {

// clang-format off
#define HD_SECOND_PARAMS(FIELD)                                                                                     \
    FIELD(gear_ratio, 0, "-", "rotor turns per joint turn")                                                        \
    FIELD(rated_torque, 0, "N m", "scale of loads")                                                                \
    FIELD(torque_limit, 0, "N m", "of the set-point")                                                              \
    FIELD(rotor_inertia, 0, "kg m^2", "output side")                                                               \
    FIELD(link_inertia, 0, "kg m^2", "about the axis, with what swings on it")                                     \
    FIELD(gravity_torque, 0, "N m", "largest gravity torque of the link")                                          \
    FIELD(gravity_angle, 0, "rad", "joint angle at which the link hangs")                                          \
    FIELD(payload_gravity, 0, "N m", "largest gravity torque of an added mass")                                    \
    FIELD(payload_angle, 0, "rad", "joint angle at which the added mass hangs")                                    \
    FIELD(payload_inertia, 0, "kg m^2", "of the added mass about the axis")                                        \
    FIELD(stiffness_1, 0, "N m/rad", "around zero torsion")                                                        \
    FIELD(stiffness_2, 0, "N m/rad", "beyond the first corner")                                                    \
    FIELD(stiffness_3, 0, "N m/rad", "beyond the second corner")                                                   \
    FIELD(corner_1, 0, "rad", "torsion of the first corner")                                                       \
    FIELD(corner_2, 0, "rad", "torsion of the second corner")                                                      \
    FIELD(corner_width, 0, "rad", "over which the stiffness changes")                                              \
    FIELD(torsional_damping, 0, "N m s/rad", "of the spring")                                                      \
    FIELD(half_gap, 0, "rad", "half the lost motion")                                                              \
    FIELD(hysteresis_torque, 0, "N m", "Bouc-Wen torque at saturation")                                            \
    FIELD(hysteresis_travel, 0, "rad", "torsion that saturates it at the initial slope")                           \
    FIELD(hysteresis_shape, 0, "-", "sigma: share of the rate-turned term, at least 0.5")                          \
    FIELD(hysteresis_exponent, 0, "-", "n: how sharply it saturates")                                              \
    FIELD(kinematic_cosine_1, 0, "rad", "kinematic error, once per rotor turn")                                    \
    FIELD(kinematic_sine_1, 0, "rad", "")                                                                          \
    FIELD(kinematic_cosine_2, 0, "rad", "twice per rotor turn")                                                    \
    FIELD(kinematic_sine_2, 0, "rad", "")                                                                          \
    FIELD(kinematic_cosine_4, 0, "rad", "four times per rotor turn")                                               \
    FIELD(kinematic_sine_4, 0, "rad", "")                                                                          \
    FIELD(kinematic_load, 0, "-", "growth of the kinematic error at rated torque")                                 \
    FIELD(tooth_height, 0, "rad", "kinematic error of a damaged tooth")                                            \
    FIELD(tooth_angle, 0, "rad", "joint angle of the tooth")                                                       \
    FIELD(tooth_width, 0, "rad", "standard width of the tooth")                                                    \
    FIELD(coulomb, 0, "N m", "sliding friction of the rotor")                                                      \
    FIELD(bristle_travel, 0, "rad", "coulomb over bristle stiffness")                                              \
    FIELD(bristle_damping, 0, "N m s/rad", "of the bristles")                                                      \
    FIELD(breakaway_share, 0, "-", "of the bristle deflection that is elastic")                                    \
    FIELD(stribeck_excess, 0, "-", "static over sliding friction, minus one")                                      \
    FIELD(stribeck_velocity, 0, "rad/s", "where half of the excess is left")                                       \
    FIELD(viscous, 0, "N m s/rad", "of the rotor at the reference temperature")                                    \
    FIELD(viscous_decay, 0, "1/K", "exponent of the viscosity over temperature")                                   \
    FIELD(reference_temperature, 0, "degC", "of the viscosity")                                                    \
    FIELD(mesh_load, 0, "1/N m", "inverse of the preload that the mesh friction is in quadrature with")            \
    FIELD(coulomb_asymmetry, 0, "-", "relative difference of the directions, half of it")                          \
    FIELD(viscous_asymmetry, 0, "-", "")                                                                           \
    FIELD(churning, 0, "N m", "at 1 rad/s")                                                                        \
    FIELD(churning_exponent, 0, "-", "power of the speed")                                                         \
    FIELD(viscous_over_angle, 0, "-", "relative swing of the viscous friction over the joint angle")               \
    FIELD(coulomb_over_angle, 0, "-", "relative swing of the sliding friction over the joint angle")               \
    FIELD(over_angle_turns, 0, "1/rad", "of both swings")                                                          \
    FIELD(over_angle_phase, 0, "rad", "of both swings")                                                            \
    FIELD(viscous_over_load, 0, "-", "relative growth of the viscous friction at rated torque")                    \
    FIELD(friction_step, 0, "-", "relative change of the sliding friction")                                        \
    FIELD(friction_step_time, 0, "s", "when it changes")                                                           \
    FIELD(cogging, 0, "N m", "torque over the rotor angle")                                                        \
    FIELD(cogging_order, 0, "1/turn", "periods per rotor turn")                                                    \
    FIELD(cogging_phase, 0, "rad", "")                                                                             \
    FIELD(cogging_second, 0, "-", "share of twice that order")                                                     \
    FIELD(ripple_share, 0, "-", "of the motor torque: current ripple")                                             \
    FIELD(ripple_order, 0, "1/turn", "of the current ripple")                                                      \
    FIELD(ripple_phase, 0, "rad", "")                                                                              \
    FIELD(torque_constant_error, 0, "-", "true over stated torque constant, minus one")                            \
    FIELD(saturation, 0, "-", "relative loss of torque at the limit, grows with the square")                       \
    FIELD(torque_disturbance, 0, "N m", "standard deviation of a white torque on the rotor, constant over a sample")   \
    FIELD(link_disturbance, 0, "N m", "the same on the link")                                                      \
    FIELD(current_lag, 0, "s", "time constant of the current loop")                                                \
    FIELD(transport_delay, 0, "s", "of the set-point")                                                             \
    FIELD(swinging_share, 0, "-", "of the link inertia behind a soft structure")                                   \
    FIELD(swinging_frequency, 0, "Hz", "of the structure with the joint held")                                     \
    FIELD(swinging_damping, 0, "-", "damping ratio of the structure")                                              \
    FIELD(link_coulomb, 0, "N m", "sliding friction of the link")                                                  \
    FIELD(link_bristle_travel, 0, "rad", "")                                                                       \
    FIELD(link_viscous, 0, "N m s/rad", "of the link")                                                             \
    FIELD(cable_torque, 0, "N m", "of a hose or cable, saturating over the joint angle")                           \
    FIELD(cable_angle, 0, "rad", "joint angle where it changes sign")                                              \
    FIELD(cable_width, 0, "rad", "")                                                                               \
    FIELD(contact_torque, 0, "N m", "friction of the link while something touches it")                             \
    FIELD(gauge_gain, 0, "-", "indicated over true torque, minus one")                                             \
    FIELD(gauge_offset, 0, "N m", "")                                                                              \
    FIELD(gauge_drift, 0, "N m/K", "of the zero with the temperature")                                             \
    FIELD(gauge_cosine_2, 0, "N m", "ripple over the wave generator angle")                                        \
    FIELD(gauge_sine_2, 0, "N m", "")                                                                              \
    FIELD(gauge_cosine_4, 0, "N m", "")                                                                            \
    FIELD(gauge_sine_4, 0, "N m", "")                                                                              \
    FIELD(gauge_turns, 0, "-", "1: the bridge turns with the joint, ripple over rotor minus joint angle; else 0")  \
    FIELD(gauge_cutoff, 0, "Hz", "of the amplifier, second order, critically damped")                              \
    FIELD(gauge_noise, 0, "N m", "standard deviation of a sample")                                                 \
    FIELD(gauge_step, 0, "N m", "of the converter")                                                                \
    FIELD(encoder_step, 0, "rad", "one count of the rotor angle")                                                  \
    FIELD(encoder_noise, 0, "rad", "standard deviation of the rotor angle reading")                                \
    FIELD(resolver_step, 0, "rad", "one count of the joint angle")                                                 \
    FIELD(resolver_noise, 0, "rad", "standard deviation of the joint angle reading")                               \
    FIELD(eccentricity, 0, "-", "distance of the disc's centre from the axis over its radius")                     \
    FIELD(eccentricity_angle, 0, "rad", "")                                                                        \
    FIELD(ellipticity, 0, "rad", "twice-per-turn error of the joint angle")                                        \
    FIELD(ellipticity_angle, 0, "rad", "")                                                                         \
    FIELD(torque_noise, 0, "N m", "standard deviation of the reported motor torque")                               \
    FIELD(torque_step, 0, "N m", "resolution of the reported motor torque")                                        \
    FIELD(torque_at_stamp, 0, "-", "1: an inner loop of 4 kHz, its set-point sampled at the stamp; 0: held from stamp to stamp") \
    FIELD(encoder_late, 0, "s", "age of the reading at its stamp")                                                 \
    FIELD(resolver_late, 0, "s", "")                                                                               \
    FIELD(gauge_late, 0, "s", "")                                                                                  \
    FIELD(torque_late, 0, "s", "of the motor torque, where it is sampled")                                         \
    FIELD(clock_drift, 0, "-", "of the joint and gauge clock against that of the drive")                           \
    FIELD(jitter, 0, "s", "standard deviation of the sampling instants")                                           \
    FIELD(ambient_temperature, 0, "degC", "")                                                                      \
    FIELD(copper_heating, 0, "K/(N m)^2", "steady rise per squared motor torque")                                  \
    FIELD(friction_heating, 0, "K/W", "steady rise per friction power")                                            \
    FIELD(thermal_time, 0, "s", "time constant of the temperature")                                                \
    FIELD(start_temperature, 0, "degC", "")                                                                        \
    FIELD(position_gain, 0, "1/s", "of the controller")                                                            \
    FIELD(velocity_gain, 0, "N m s/rad", "")                                                                       \
    FIELD(integral_gain, 0, "N m/rad/s", "")                                                                       \
    FIELD(velocity_cutoff, 0, "rad/s", "of the controller's velocity filter")                                      \
    FIELD(feed_gravity, 0, "N m", "gravity torque that the controller adds")
// clang-format on

#define HD_SECOND_NUMBER(name, ...) double name;
#define HD_SECOND_READ(name, ...) name = *from++;
#define HD_SECOND_ENTRY(name, ...) {#name, __VA_ARGS__},

struct Params {
    HD_SECOND_PARAMS(HD_SECOND_NUMBER)
    explicit Params(const double* from) { HD_SECOND_PARAMS(HD_SECOND_READ) }
    static const std::vector<hd::Field>& fields() {
        static const std::vector<hd::Field> list{HD_SECOND_PARAMS(HD_SECOND_ENTRY)};
        return list;
    }
};

using Windows = std::vector<std::array<double, 2>>;  // s, while the contact touches

enum Place {
    PHI,
    PHI_RATE,
    Q,
    Q_RATE,
    BRISTLE,
    LINK_BRISTLE,
    BOUC_WEN,
    CURRENT,
    SWING,
    SWING_RATE,
    GAUGE,
    GAUGE_RATE,
    WARM,
    SIZE
};
using State = std::array<double, SIZE>;

// Disturbing torques, N m.
struct Push {
    double rotor = 0.0, link = 0.0;
};

// Torques of one instant that observers and tests read.
struct Torques {
    double joint = 0.0;     // that the flexspline gives the link
    double spring = 0.0;    // of the wound gear before geometry
    double friction = 0.0;  // that resists the rotor
    double motor = 0.0;     // air-gap torque on the rotor, with ripple, without cogging
    double torsion = 0.0;   // rad
};

inline double sign(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : 0.0; }

// Smooth ramp: 0 below, x above, over the width.
inline double softplus(double x, double width) {
    const double r = x / width;
    return r > 30.0 ? x : r < -30.0 ? 0.0 : width * std::log1p(std::exp(r));
}

// Odd dead zone of half width `gap` with rounded corners.
inline double dead_zone(double x, double gap, double width) {
    return softplus(x - gap, width) - softplus(-x - gap, width);
}

// Elasto-plastic bristle (Dupont, Hayward, Armstrong and Altpeter, 2002): rate of the deflection z at speed v, when
// steady sliding bends it by `steady` and it is purely elastic up to `share` of that.
inline double bristle_rate(double z, double v, double steady, double share) {
    if (v == 0.0 || z * v <= 0.0) return v;
    const double size = std::fabs(z), elastic = share * steady;
    if (size <= elastic) return v;
    const double middle = 0.5 * (steady + elastic);
    const double alpha = size >= steady ? 1.0 : 0.5 + 0.5 * std::sin(M_PI * (size - middle) / (steady - elastic));
    return v * (1.0 - alpha * size / steady);
}

// Bouc-Wen variable in the normalised form of Ikhouane and Rodellar (2007): rate of w for torsion rate x'.
inline double bouc_wen_rate(double w, double rate, double travel, double shape, double exponent) {
    const double size = std::fabs(w), power = exponent == 1.0 ? size : std::pow(size, exponent);
    return (rate - shape * std::fabs(rate) * sign(w) * power + (shape - 1.0) * rate * power) / travel;
}

class Joint {
  public:
    Joint(const Params& params, Windows windows) : p_(params), windows_(std::move(windows)) {
        s_.fill(0.0);
        s_[WARM] = p_.start_temperature;
        steps_angle_ = p_.viscous_over_angle != 0.0 || p_.coulomb_over_angle != 0.0;
        kinematic_ = p_.kinematic_cosine_1 != 0.0 || p_.kinematic_sine_1 != 0.0 || p_.kinematic_cosine_2 != 0.0 ||
                     p_.kinematic_sine_2 != 0.0 || p_.kinematic_cosine_4 != 0.0 || p_.kinematic_sine_4 != 0.0;
    }

    const State& state() const { return s_; }
    State& state() { return s_; }
    double time() const { return t_; }
    const Params& params() const { return p_; }

    // Torque of the wound gear without damping and hysteresis; odd in the torsion.
    double elastic(double torsion) const {
        const double x = p_.half_gap > 0.0 ? dead_zone(torsion, p_.half_gap, p_.half_gap / 8.0) : torsion;
        double torque = p_.stiffness_1 * x;
        if (p_.stiffness_2 != p_.stiffness_1)
            torque += (p_.stiffness_2 - p_.stiffness_1) * dead_zone(x, p_.corner_1, p_.corner_width);
        if (p_.stiffness_3 != p_.stiffness_2)
            torque += (p_.stiffness_3 - p_.stiffness_2) * dead_zone(x, p_.corner_2, p_.corner_width);
        return torque;
    }

    // Sliding friction torque at steady speed, without the viscous part.
    double sliding(double v, double load, double angle, double t) const {
        double f = p_.coulomb;
        if (p_.stribeck_excess != 0.0) {
            const double r = v / p_.stribeck_velocity;
            f *= 1.0 + p_.stribeck_excess / (1.0 + r * r);
        }
        if (p_.mesh_load != 0.0) f *= std::sqrt(1.0 + p_.mesh_load * p_.mesh_load * load * load);
        f *= 1.0 + p_.coulomb_asymmetry * sign(v);
        if (steps_angle_) f *= 1.0 + p_.coulomb_over_angle * swing(angle);
        if (t >= p_.friction_step_time) f *= 1.0 + p_.friction_step;
        return f;
    }

    // What grows with the speed.
    double fluid(double v, double load, double angle, double warm) const {
        double c = p_.viscous * (1.0 + p_.viscous_asymmetry * sign(v));
        if (p_.viscous_decay != 0.0) c *= std::exp(-p_.viscous_decay * (warm - p_.reference_temperature));
        if (steps_angle_) c *= 1.0 + p_.viscous_over_angle * swing(angle);
        if (p_.viscous_over_load != 0.0) c *= 1.0 + p_.viscous_over_load * std::fabs(load) / p_.rated_torque;
        double f = c * v;
        if (p_.churning != 0.0) f += p_.churning * sign(v) * std::pow(std::fabs(v), p_.churning_exponent);
        return f;
    }

    // Rates of everything while the set-point that reaches the current loop is `set_point` and `push` disturbs it.
    State rates(const State& s, double t, double set_point, const Push& push, Torques& out) const {
        State d;
        const double v = s[PHI_RATE], rate = s[Q_RATE];
        const Geometry g = geometry(s[PHI], s[Q]);
        const double torsion_rate = g.by_motor * v - g.by_joint * rate;
        out.torsion = g.torsion;
        out.spring = elastic(g.torsion) + p_.torsional_damping * torsion_rate;
        d[BOUC_WEN] = 0.0;
        if (p_.hysteresis_torque != 0.0) {
            out.spring += p_.hysteresis_torque * s[BOUC_WEN];
            d[BOUC_WEN] = bouc_wen_rate(s[BOUC_WEN], torsion_rate, p_.hysteresis_travel, p_.hysteresis_shape,
                                        p_.hysteresis_exponent);
        }
        out.joint = out.spring * g.by_joint;

        const double stiffness = p_.coulomb / p_.bristle_travel, slide = sliding(v, out.spring, s[Q], t);
        d[BRISTLE] = stiffness == 0.0 ? 0.0 : bristle_rate(s[BRISTLE], v, slide / stiffness, p_.breakaway_share);
        out.friction = stiffness * s[BRISTLE] + p_.bristle_damping * d[BRISTLE] + fluid(v, out.spring, s[Q], s[WARM]);

        d[CURRENT] = (set_point - s[CURRENT]) / p_.current_lag;
        out.motor = air_gap(s[CURRENT], s[PHI]);
        d[PHI] = v;
        d[PHI_RATE] =
            (out.motor + push.rotor + cogging(s[PHI]) - out.spring * g.by_motor - out.friction) / p_.rotor_inertia;
        link(s, t, out.joint + push.link, d);
        gauge(s, out.joint, d);
        const double rise =
            p_.copper_heating * s[CURRENT] * s[CURRENT] + p_.friction_heating * std::fabs(out.friction * v);
        d[WARM] = (p_.ambient_temperature + rise - s[WARM]) / p_.thermal_time;
        return d;
    }

    void step(double h, double set_point, const Push& push = {}) {
        Torques unused;
        const State a = rates(s_, t_, set_point, push, unused);
        const State b = rates(moved(a, 0.5 * h), t_ + 0.5 * h, set_point, push, unused);
        const State c = rates(moved(b, 0.5 * h), t_ + 0.5 * h, set_point, push, unused);
        const State e = rates(moved(c, h), t_ + h, set_point, push, unused);
        for (int i = 0; i < SIZE; ++i) s_[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + e[i]);
        t_ += h;
    }

    // Kinetic, elastic and potential energy; hysteresis and bristles are not in it.
    double energy() const {
        const Geometry g = geometry(s_[PHI], s_[Q]);
        const double inertia = p_.link_inertia + p_.payload_inertia, soft = p_.swinging_share * inertia;
        const double w = 2.0 * M_PI * p_.swinging_frequency, far = s_[Q_RATE] + s_[SWING_RATE];
        double sum = 0.5 * p_.rotor_inertia * s_[PHI_RATE] * s_[PHI_RATE];
        sum +=
            0.5 * (inertia - soft) * s_[Q_RATE] * s_[Q_RATE] + 0.5 * soft * (far * far + w * w * s_[SWING] * s_[SWING]);
        const int n = 400;  // the spring's energy by Simpson's rule
        double work = 0.0;
        for (int i = 0; i <= n; ++i) work += elastic(g.torsion * i / n) * (i == 0 || i == n ? 1.0 : i % 2 ? 4.0 : 2.0);
        sum += work * g.torsion / (3.0 * n);
        sum -= p_.gravity_torque * std::cos(s_[Q] - p_.gravity_angle);
        return sum - p_.payload_gravity * std::cos(s_[Q] - p_.payload_angle);
    }

    // At rest at a joint angle, wound up by gravity.
    void rest(double angle) {
        s_.fill(0.0);
        s_[WARM] = p_.start_temperature;
        s_[Q] = angle;
        const double load = gravity(angle);
        double low = -0.1, high = 0.1;  // torsion by bisection; the spring is monotone
        for (int i = 0; i < 60; ++i) {
            const double middle = 0.5 * (low + high);
            (elastic(middle) < load ? low : high) = middle;
        }
        s_[PHI] = angle + 0.5 * (low + high);
        s_[CURRENT] = load;
        s_[GAUGE] = load;
    }

    double gravity(double q) const {
        double torque = p_.gravity_torque * std::sin(q - p_.gravity_angle);
        if (p_.payload_gravity != 0.0) torque += p_.payload_gravity * std::sin(q - p_.payload_angle);
        return torque;
    }

  private:
    struct Geometry {
        double torsion, by_motor, by_joint;  // torsion and its slopes over the rotor and against the joint angle
    };

    // torsion = phi - q + E(N phi) (1 + c k (phi - q) / rated) + tooth(q): the spring acts through its slopes, so that
    // energy is kept.
    Geometry geometry(double phi, double q) const {
        Geometry g{phi - q, 1.0, 1.0};
        if (kinematic_) {
            const double theta = p_.gear_ratio * phi;
            const double c1 = std::cos(theta), s1 = std::sin(theta);
            const double c2 = c1 * c1 - s1 * s1, s2 = 2.0 * s1 * c1, c4 = c2 * c2 - s2 * s2, s4 = 2.0 * s2 * c2;
            const double error = p_.kinematic_cosine_1 * c1 + p_.kinematic_sine_1 * s1 + p_.kinematic_cosine_2 * c2 +
                                 p_.kinematic_sine_2 * s2 + p_.kinematic_cosine_4 * c4 + p_.kinematic_sine_4 * s4;
            const double slope = p_.kinematic_sine_1 * c1 - p_.kinematic_cosine_1 * s1 +
                                 2.0 * (p_.kinematic_sine_2 * c2 - p_.kinematic_cosine_2 * s2) +
                                 4.0 * (p_.kinematic_sine_4 * c4 - p_.kinematic_cosine_4 * s4);
            const double growth = p_.kinematic_load * p_.stiffness_1 / p_.rated_torque, load = 1.0 + growth * (phi - q);
            g.torsion += error * load;
            g.by_motor += p_.gear_ratio * slope * load + error * growth;
            g.by_joint += error * growth;
        }
        if (p_.tooth_height != 0.0) {
            const double r = (q - p_.tooth_angle) / p_.tooth_width, height = p_.tooth_height * std::exp(-0.5 * r * r);
            g.torsion += height;
            g.by_joint += height * r / p_.tooth_width;
        }
        return g;
    }

    double swing(double angle) const { return std::sin(p_.over_angle_turns * angle + p_.over_angle_phase); }

    double air_gap(double current, double phi) const {
        const double r = current / p_.torque_limit;
        double torque = current * (1.0 + p_.torque_constant_error) * (1.0 - p_.saturation * r * r);
        if (p_.ripple_share != 0.0)
            torque *= 1.0 + p_.ripple_share * std::sin(p_.ripple_order * p_.gear_ratio * phi + p_.ripple_phase);
        return torque;
    }

    double cogging(double phi) const {
        if (p_.cogging == 0.0) return 0.0;
        const double angle = p_.cogging_order * p_.gear_ratio * phi + p_.cogging_phase;
        return p_.cogging * (std::sin(angle) + p_.cogging_second * std::sin(2.0 * angle));
    }

    bool touched(double t) const {
        for (const auto& window : windows_)
            if (t >= window[0] && t < window[1]) return true;
        return false;
    }

    void link(const State& s, double t, double torque, State& d) const {
        const double rate = s[Q_RATE];
        double sum = torque - gravity(s[Q]) - p_.link_viscous * rate;
        d[LINK_BRISTLE] = 0.0;
        if (p_.link_coulomb != 0.0) {
            const double travel = p_.link_bristle_travel;
            d[LINK_BRISTLE] = bristle_rate(s[LINK_BRISTLE], rate, travel, p_.breakaway_share);
            sum -= p_.link_coulomb * s[LINK_BRISTLE] / travel;
        }
        if (p_.cable_torque != 0.0) sum -= p_.cable_torque * std::tanh((s[Q] - p_.cable_angle) / p_.cable_width);
        if (p_.contact_torque != 0.0 && touched(t)) sum -= p_.contact_torque * std::tanh(rate / 0.005);
        const double inertia = p_.link_inertia + p_.payload_inertia, soft = p_.swinging_share * inertia;
        d[Q] = rate;
        d[SWING] = d[SWING_RATE] = 0.0;
        if (soft == 0.0) {
            d[Q_RATE] = sum / inertia;
            return;
        }
        const double w = 2.0 * M_PI * p_.swinging_frequency;
        const double pull =
            w * w * s[SWING] + 2.0 * p_.swinging_damping * w * s[SWING_RATE];  // per inertia that swings
        d[Q_RATE] = (sum + soft * pull) / (inertia - soft);
        d[SWING] = s[SWING_RATE];
        d[SWING_RATE] = -pull - d[Q_RATE];
    }

    void gauge(const State& s, double torque, State& d) const {
        const double w = 2.0 * M_PI * p_.gauge_cutoff;
        d[GAUGE] = s[GAUGE_RATE];
        d[GAUGE_RATE] = w * w * (torque - s[GAUGE]) - 2.0 * w * s[GAUGE_RATE];
    }

    State moved(const State& rate, double h) const {
        State s;
        for (int i = 0; i < SIZE; ++i) s[i] = s_[i] + h * rate[i];
        return s;
    }

    Params p_;
    Windows windows_;
    State s_;
    double t_ = 0.0;
    bool steps_angle_, kinematic_;
};

}  // namespace hd_second
