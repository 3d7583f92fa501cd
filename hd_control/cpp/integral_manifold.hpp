// Composite position control of one joint with known smooth load: Gandhi and Ghorbel (26)-(30), (31), corrected.
//
//   code                            paper             code                         paper
//   rotor_, link_ (angles, rates)   theta_m, theta_l  Yp, p2, p3                   Y_p, theta_p'', theta_p'''
//   torsional_stiffness             K                 manifold_torque              h_0
//   perturbation_stiffness          K_1               hysteresis_torque            -q
//   epsilon                         sqrt(K_1 / K)     load_torque                  tau_l
//   tracking_gain, tracking_damping Lambda, k_d       fast_gain                    K_D
//
// Blocks are output side (torques x N, inertias x N^2); inside, the paper's motor side. The kinematic error of a block
// is -theta_p. The hysteresis torque is the law's own, moved by the measured torsion along its exact solution.
#pragma once

#include <algorithm>
#include <cmath>

#include "blocks.hpp"
#include "law_math.hpp"
#include "torque_adaptive.hpp"

namespace hd {

#define HD_MANIFOLD_PARAMS(FIELD)                                                                                     \
    FIELD(composition, 0, "-", "terms of the integral-manifold law", one_of("comparison tau_0 tau_1 tau_2 all"))      \
    FIELD(prediction_samples, 0, "-", "from the measurement to the middle of the command's hold", at_least(0.0, 4.5)) \
    FIELD(load_source, 0, "-", "load: function of the wanted position, or required torque",                           \
          one_of("position required"))                                                                                \
    FIELD(hysteresis_source, 0, "-",                                                                                  \
          "hysteresis torque from the measured torsion (fine sensors), or from the wanted torque",                    \
          one_of("measured wanted"))                                                                                  \
    HD_RATE_SOURCE(FIELD)                                                                                             \
    HD_DERIVATIVE_CUTOFF(FIELD)                                                                                       \
    HD_GEAR_RATIO(FIELD)                                                                                              \
    HD_TORSIONAL_STIFFNESS(FIELD)                                                                                     \
    HD_ROTOR_INERTIA(FIELD)                                                                                           \
    HD_MOTOR_TORQUE_LIMIT(FIELD)                                                                                      \
    HD_KINEMATIC_ERROR(FIELD)                                                                                         \
    HD_LINK_INERTIA(FIELD)                                                                                            \
    FIELD(stiffness_cubic, 1, "N m/rad^3", "cubic part of the spring; 0 in the law of the paper", at_least(0.0))      \
    FIELD(stiffness_quintic, 1, "N m/rad^5", "quintic part of the spring", at_least(0.0))                             \
    FIELD(rotor_coulomb, 1, "N m", "Coulomb friction of the rotor, fed forward; 0 in the paper",                      \
          at_least(0.0).times(2.0).within(0.1))                                                                       \
    FIELD(friction_speed, 1, "rad/s", "wanted speed at which 76 % of rotor_coulomb are fed forward", above(0.0))      \
    FIELD(rotor_damping, 1, "N m s", "viscous damping of the rotor, output side",                                     \
          at_least(0.0).times(2.0).within(0.2))                                                                       \
    FIELD(link_damping, 1, "N m s", "viscous damping of the link", at_least(0.0))                                     \
    FIELD(hysteresis_stiffness, 1, "N m/rad", "slope of the hysteresis torque after a reversal", at_least(0.0))       \
    FIELD(hysteresis_rate, 1, "1/rad", "how fast it saturates; it ends at hysteresis_stiffness / hysteresis_rate",    \
          at_least(0.0))                                                                                              \
    FIELD(perturbation_stiffness, 1, "N m/rad", "scale of the fast variable", above(0.0))                             \
    FIELD(tracking_gain, 1, "1/s", "position error to velocity", at_least(0.0))                                       \
    FIELD(tracking_damping, 1, "N m s", "velocity error to torque", at_least(0.0))                                    \
    FIELD(fast_gain, 1, "s", "gain of the fast term, from fast_damping_ratio")                                        \
    FIELD(load_constant, 1, "N m", "known load: constant part")                                                       \
    FIELD(load_cosine, 1, "N m", "known load: with cos q_d")                                                          \
    FIELD(load_sine, 1, "N m", "known load: with sin q_d")

#define HD_MANIFOLD_REFERENCE(FIELD)                                     \
    FIELD(desired_position, 1, "rad", "r")                               \
    FIELD(desired_velocity, 1, "rad/s", "r'")                            \
    FIELD(desired_acceleration, 1, "rad/s^2", "r''")                     \
    FIELD(desired_jerk, 1, "rad/s^3", "r'''")                            \
    FIELD(desired_snap, 1, "rad/s^4", "r''''")                           \
    FIELD(load_torque, 1, "N m", "tau_l, against positive joint motion") \
    FIELD(load_rate, 1, "N m/s", "tau_l'")                               \
    FIELD(load_acceleration, 1, "N m/s^2", "tau_l''")

#define HD_MANIFOLD_STATE(FIELD)                                                  \
    FIELD(started, 1, "-", "1 after the first usable sample")                     \
    FIELD(hysteresis_torque, 1, "N m", "-q at the last sample")                   \
    FIELD(torsion_last, 1, "rad", "torsion of the last sample")                   \
    FIELD(motor_torque_last, 1, "N m", "last command")                            \
    FIELD(spring_torque_last, 1, "N m", "wanted joint torque of the last sample") \
    FIELD(wanted_torsion, 1, "rad", "torsion of the wanted motion")               \
    FIELD(joint_filter_last, 1, "rad", "wanted joint position in the filter D")   \
    FIELD(joint_filter_rate, 1, "rad/s", "its rate behind D")                     \
    FIELD(motor_filter_last, 1, "rad", "wanted motor position in the filter D")   \
    FIELD(motor_filter_rate, 1, "rad/s", "its rate behind D")                     \
    FIELD(velocity_1, 1, "rad/s", "wanted velocity one sample ago")               \
    FIELD(velocity_2, 1, "rad/s", "wanted velocity two samples ago")              \
    FIELD(velocity_3, 1, "rad/s", "wanted velocity three samples ago")            \
    FIELD(required_1, 1, "N m", "required torque one sample ago")                 \
    FIELD(required_2, 1, "N m", "required torque two samples ago")

#define HD_MANIFOLD_OUTPUT(FIELD)                                                           \
    FIELD(motor_torque, 1, "N m", "u, output side: sum of the terms and saturation_torque") \
    FIELD(damping_term, 1, "N m", "term: B_m theta_m'")                                     \
    FIELD(friction_term, 1, "N m", "term: Coulomb friction fed forward")                    \
    FIELD(fast_term, 1, "N m", "term: tau_f, or K_f (theta_l' - theta_m' / N) of (31)")     \
    FIELD(slow_term_0, 1, "N m", "term: tau_0, or the rigid part of (31)")                  \
    FIELD(slow_term_1, 1, "N m", "term: epsilon tau_1")                                     \
    FIELD(slow_term_2, 1, "N m", "term: epsilon^2 tau_2")                                   \
    FIELD(slow_term_4, 1, "N m", "term: epsilon^4 tau_4")                                   \
    FIELD(saturation_torque, 1, "N m", "what motor_torque_limit took off")                  \
    FIELD(position_error, 1, "rad", "e at the measurement")                                 \
    FIELD(hysteresis_torque, 1, "N m", "-q where the law acts")                             \
    FIELD(manifold_torque, 1, "N m", "h_0")                                                 \
    FIELD(manifold_torque_rate, 1, "N m/s", "h_0'")                                         \
    FIELD(manifold_torque_acceleration, 1, "N m/s^2", "h_0''")                              \
    FIELD(predicted_joint_position, 1, "rad", "theta_l where the law acts")                 \
    FIELD(predicted_motor_position, 1, "rad", "theta_m / N where the law acts")

HD_BLOCK(ManifoldParams, HD_MANIFOLD_PARAMS)
HD_BLOCK(ManifoldReference, HD_MANIFOLD_REFERENCE)
HD_BLOCK(ManifoldState, HD_MANIFOLD_STATE)
HD_BLOCK(ManifoldOutput, HD_MANIFOLD_OUTPUT)

constexpr double kPredictionStep = 2.5e-4;  // s, longest Runge-Kutta step of the prediction

struct Transmission {
    double value = 0.0, slope = 0.0, curvature = 0.0, third = 0.0;
};

// Kinematic error of the blocks and its derivatives with respect to the rotor angle.
inline Transmission transmission(double angle, const double* cosine, const double* sine) {
    Transmission t;
    for (int i = 0; i < kHarmonics; ++i) {
        const double n = i + 1, c = std::cos(n * angle), s = std::sin(n * angle);
        const double in_phase = cosine[i] * c + sine[i] * s, across = n * (sine[i] * c - cosine[i] * s);
        t.value += in_phase;
        t.slope += across;
        t.curvature -= n * n * in_phase;
        t.third -= n * n * across;
    }
    return t;
}

struct Wanted {
    double r, r1, r2, r3, r4, load, load1, load2;

    Wanted later(double s) const {
        return {r + s * (r1 + s / 2 * (r2 + s / 3 * (r3 + s / 4 * r4))),
                r1 + s * (r2 + s / 2 * (r3 + s / 3 * r4)),
                r2 + s * (r3 + s / 2 * r4),
                r3 + s * r4,
                r4,
                load + s * (load1 + s / 2 * load2),
                load1 + s * load2,
                load2};
    }
};

// Output side.
struct JointMotion {
    double motor, motor_rate, joint, joint_rate;
};

struct ManifoldStep {
    const ManifoldParams& p;
    const int j;

    const double* cosine() const { return &p.kinematic_cosine[kHarmonics * j]; }
    const double* sine() const { return &p.kinematic_sine[kHarmonics * j]; }

    double torsion(const JointMotion& m) const {
        return m.motor - m.joint + transmission(p.gear_ratio[j] * m.motor, cosine(), sine()).value;
    }

    // Spring without hysteresis, its slope and the slope of that: (5).
    double spring(double x) const {
        const double s = x * x;
        return x * (p.torsional_stiffness[j] + s * (p.stiffness_cubic[j] + s * p.stiffness_quintic[j]));
    }
    double tangent(double x) const {
        const double s = x * x;
        return p.torsional_stiffness[j] + s * (3.0 * p.stiffness_cubic[j] + s * 5.0 * p.stiffness_quintic[j]);
    }
    double bend(double x) const { return x * (6.0 * p.stiffness_cubic[j] + 20.0 * p.stiffness_quintic[j] * x * x); }

    // Exact solution of (10) for a torsion that moves monotonically by `way` from the hysteresis torque h.
    double moved_hysteresis(double h, double way) const {
        const double rate = p.hysteresis_rate[j], A = p.hysteresis_stiffness[j];
        if (rate == 0.0) return h + A * way;
        const double level = way >= 0.0 ? A / rate : -A / rate;
        return level + (h - level) * std::exp(-rate * std::fabs(way));
    }

    // At the start it follows from the gauge, within what the hysteresis can hold.
    double first_hysteresis(double joint_torque, double torsion) const {
        const double rest = joint_torque - spring(torsion);
        if (p.hysteresis_rate[j] == 0.0 || !std::isfinite(rest)) return 0.0;
        const double most = p.hysteresis_stiffness[j] / p.hysteresis_rate[j];
        return std::min(std::max(rest, -most), most);
    }

    double friction(double speed) const { return p.rotor_coulomb[j] * std::tanh(speed / p.friction_speed[j]); }

    // The law's own model of the joint, for the prediction.
    JointMotion model(const JointMotion& m, double u, double load, double from, double h, double friction) const {
        const Transmission t = transmission(p.gear_ratio[j] * m.motor, cosine(), sine());
        const double now = m.motor - m.joint + t.value;
        const double torque = spring(now) + moved_hysteresis(h, now - from);
        const double Y = 1.0 + p.gear_ratio[j] * t.slope;
        return {m.motor_rate, (u - Y * torque - p.rotor_damping[j] * m.motor_rate - friction) / p.rotor_inertia[j],
                m.joint_rate, (torque - load - p.link_damping[j] * m.joint_rate) / p.link_inertia[j]};
    }

    static JointMotion along(const JointMotion& m, const JointMotion& rate, double s) {
        return {m.motor + s * rate.motor, m.motor_rate + s * rate.motor_rate, m.joint + s * rate.joint,
                m.joint_rate + s * rate.joint_rate};
    }

    // Moves the motion and the hysteresis torque ahead by `time` with the command u held.
    void predict(JointMotion& m, double& h, double u, const Wanted& want, double time) const {
        const int steps = std::max(1, static_cast<int>(std::ceil(time / kPredictionStep)));
        const double s = time / steps;
        for (int i = 0; i < steps; ++i) {
            const double from = torsion(m), t = i * s;
            const double L0 = want.later(t).load, L1 = want.later(t + s / 2).load, L2 = want.later(t + s).load;
            const double f = friction(want.r1);
            const JointMotion a = model(m, u, L0, from, h, f), b = model(along(m, a, s / 2), u, L1, from, h, f);
            const JointMotion c = model(along(m, b, s / 2), u, L1, from, h, f);
            const JointMotion d = model(along(m, c, s), u, L2, from, h, f);
            m = along(along(along(along(m, a, s / 6), b, s / 3), c, s / 3), d, s / 6);
            h = moved_hysteresis(h, torsion(m) - from);
        }
    }

    // (26)-(30), (49), (50) and the derivatives of h_0 on the manifold.
    void composite(const JointMotion& m, double h, const Wanted& w, ManifoldOutput& out) const {
        const double N = p.gear_ratio[j], K1 = p.perturbation_stiffness[j], x = torsion(m), K = tangent(x);
        const double Jm = p.rotor_inertia[j] / (N * N), Jl = p.link_inertia[j], Bl = p.link_damping[j];
        const double Lambda = p.tracking_gain[j], KD = p.fast_gain[j], eps = std::sqrt(K1 / K), q = -h;
        const Transmission t = transmission(N * m.motor, cosine(), sine());
        const double Yp = 1.0 / N + t.slope, p2 = -t.curvature, p3 = -t.third;
        const double v = m.joint_rate, rotor_rate = N * m.motor_rate;
        const double e = m.joint - w.r, e1 = v - w.r1, sum = e1 + Lambda * e;
        const double D = Jm / (Yp * Yp) + Jl, c = Jm * p2 / (Yp * Yp * Yp), c4 = c / Yp;
        const double tau0 = Yp * (D * (w.r2 - Lambda * e1) + (c4 * v + Bl) * (w.r1 - Lambda * e) -
                                  p.tracking_damping[j] * sum + w.load);
        const double Gamma = (c4 * v + Bl + p.tracking_damping[j]) / D, accel = w.r2 - Lambda * e1 - Gamma * sum;
        const double e2 = accel - w.r2, slow_rate = v / Yp;
        const double Yp_rate = -p2 * slow_rate, D_rate = -2.0 * Jm * Yp_rate / (Yp * Yp * Yp);
        const double c4_rate = Jm * p3 * slow_rate / std::pow(Yp, 4) - 4.0 * Jm * p2 * Yp_rate / std::pow(Yp, 5);
        const double Gamma_rate = (c4_rate * v + c4 * accel) / D - Gamma * D_rate / D;
        const double jerk = w.r3 - Lambda * e2 - Gamma * (e2 + Lambda * e1) - Gamma_rate * sum;
        const double s1 = Jl * jerk + Bl * accel + w.load1, s2 = Jl * w.r4 + Bl * jerk + w.load2;
        const double side = sign(s1), alpha = p.hysteresis_rate[j];
        const double den = 1.0 + (p.hysteresis_stiffness[j] + alpha * q * side) / K;
        const double h1 = s1 / den, q_rate = -(alpha * q * std::fabs(h1) + p.hysteresis_stiffness[j] * h1) / K;
        const double K_rate = bend(x) * h1 / K;
        const double den_rate = alpha * q_rate * side / K - (den - 1.0) * K_rate / K;
        const double h2 = s2 / den - s1 * den_rate / (den * den);
        const double C1 = K1 * Yp / Jm;
        out.manifold_torque[j] = Jl * accel + Bl * v + w.load + q;
        out.manifold_torque_rate[j] = h1;
        out.manifold_torque_acceleration[j] = h2;
        const double order = p.composition[0];
        out.damping_term[j] = p.rotor_damping[j] * m.motor_rate;
        out.friction_term[j] = friction(w.r1);
        out.fast_term[j] = N * KD * eps * K * (v - Yp * rotor_rate);
        out.slow_term_0[j] = N * tau0;
        out.slow_term_1[j] = order < 2.0 ? 0.0 : N * eps * KD * h1;
        out.slow_term_2[j] = order < 3.0 ? 0.0 : N * eps * eps * (c * 2.0 * v / K1 * h1 + (h2 - h1 * K_rate / K) / C1);
        out.slow_term_4[j] = order < 4.0 ? 0.0 : N * std::pow(eps, 4) * c * h1 * h1 / (K1 * K1);
    }

    // (31) with the load used once: neither kinematic error nor hysteresis.
    void comparison(const JointMotion& m, const Wanted& w, ManifoldOutput& out) const {
        const double N = p.gear_ratio[j], K = p.torsional_stiffness[j], Lambda = p.tracking_gain[j];
        const double e = m.joint - w.r, e1 = m.joint_rate - w.r1;
        const double fast = p.fast_gain[j] * std::sqrt(p.perturbation_stiffness[j] / K) * K;
        out.damping_term[j] = p.rotor_damping[j] * m.motor_rate;
        out.friction_term[j] = friction(w.r1);
        out.fast_term[j] = N * fast * (m.joint_rate - m.motor_rate);
        out.slow_term_0[j] = (p.link_inertia[j] + p.rotor_inertia[j]) * (w.r2 - Lambda * e1) +
                             p.link_damping[j] * (w.r1 - Lambda * e) - p.tracking_damping[j] * (e1 + Lambda * e) +
                             w.load;
        out.slow_term_1[j] = out.slow_term_2[j] = out.slow_term_4[j] = 0.0;
    }
};

// One sample of the integral-manifold law: what it takes from the measurement, from the wanted motion and from the
// chain.
//
// With `rate_source` error_filter the measured rates, which carry the lag of the filter D, get back what D takes off
// the wanted motion. The wanted rotor moves against the kinematic error and winds the spring, so that its rate is known
// as well.

inline Wanted wanted(const ManifoldReference& ref, int j) {
    return {ref.desired_position[j], ref.desired_velocity[j], ref.desired_acceleration[j],
            ref.desired_jerk[j],     ref.desired_snap[j],     ref.load_torque[j],
            ref.load_rate[j],        ref.load_acceleration[j]};
}

// What the wanted motion asks of the spring: torque, torsion, its rate, and the hysteresis torque that belongs to it.
struct WantedSpring {
    double torque, torsion, torsion_rate, hysteresis;
};

// One sample further from torsion x and hysteresis torque h: one Newton step of spring + hysteresis = wanted torque.
inline WantedSpring wind(const ManifoldStep& law, const Wanted& w, double last, double x, double h, bool first) {
    const ManifoldParams& p = law.p;
    const int j = law.j;
    const double torque = p.link_inertia[j] * w.r2 + p.link_damping[j] * w.r1 + w.load;
    const double rate = p.link_inertia[j] * w.r3 + p.link_damping[j] * w.r2 + w.load1;
    const double side = rate > 0.0 ? 1.0 : -1.0, A = p.hysteresis_stiffness[j], alpha = p.hysteresis_rate[j];
    if (first) return {torque, x, rate / (law.tangent(x) + A - alpha * side * h), h};
    const double step = torque - last, turn = step > 0.0 ? 1.0 : -1.0;
    double way = step / (law.tangent(x) + A - alpha * turn * h);
    const double off = law.spring(x + way) - law.spring(x) + law.moved_hysteresis(h, way) - h - step;
    const double moved = law.moved_hysteresis(h, way);
    way -= off / (law.tangent(x + way) + A - alpha * turn * moved);
    const double end = law.moved_hysteresis(h, way);
    return {torque, x + way, rate / (law.tangent(x + way) + A - alpha * side * end), end};
}

// The wanted positions behind the filter D, and what it lags.
struct RateFilters {
    double joint_last, joint_rate, motor_last, motor_rate;
};

inline void put_lag_back(const ManifoldStep& law, RateFilters& f, const Wanted& w, const WantedSpring& spring,
                         JointMotion& m, bool first, double T) {
    const double N = law.p.gear_ratio[law.j], pole = derivative_pole(law.p.derivative_cutoff[0], T);
    const Transmission t = transmission(N * m.motor, law.cosine(), law.sine());
    const double motor = w.r + spring.torsion - t.value;
    const double motor_rate = (w.r1 + spring.torsion_rate) / (1.0 + N * t.slope);
    if (first) f = {w.r, w.r1, motor, motor_rate};
    if (!first) differentiate(w.r, f.joint_last, f.joint_rate, pole, T);
    if (!first) differentiate(motor, f.motor_last, f.motor_rate, pole, T);
    m.joint_rate += w.r1 - f.joint_rate;
    m.motor_rate += motor_rate - f.motor_rate;
}

inline void decide(const ManifoldStep& law, const JointMotion& m, double h, const Wanted& there, ManifoldOutput& out) {
    const int j = law.j;
    out.hysteresis_torque[j] = h;
    out.predicted_joint_position[j] = m.joint;
    out.predicted_motor_position[j] = m.motor;
    out.manifold_torque[j] = out.manifold_torque_rate[j] = out.manifold_torque_acceleration[j] = 0.0;
    if (law.p.composition[0] == 0.0) {
        law.comparison(m, there, out);
    } else {
        law.composite(m, h, there, out);
    }
    const double u = out.damping_term[j] + out.friction_term[j] + out.fast_term[j] + out.slow_term_0[j] +
                     out.slow_term_1[j] + out.slow_term_2[j] + out.slow_term_4[j];
    const double limit = law.p.motor_torque_limit[j];
    out.motor_torque[j] = u != u ? u : std::min(std::max(u, -limit), limit);
    out.saturation_torque[j] = out.motor_torque[j] - u;
}

// One joint, one sample. A joint whose inputs give no finite torque says so and keeps its memory as it was.
inline void manifold_joint(const ManifoldParams& p, ManifoldState& state, const TorqueSample& in, const Wanted& want,
                           ManifoldOutput& out, int j, double T) {
    const ManifoldStep law{p, j};
    JointMotion m{in.motor_position[j], in.motor_velocity[j], in.joint_position[j], in.joint_velocity[j]};
    const bool first = state.started[j] == 0.0;
    const double torsion = law.torsion(m);
    double now = first ? law.first_hysteresis(in.joint_torque[j], torsion) : state.hysteresis_torque[j];
    const WantedSpring spring =
        wind(law, want, state.spring_torque_last[j], first ? torsion : state.wanted_torsion[j], now, first);
    if (p.hysteresis_source[0] != 0.0) {
        now = spring.hysteresis;
    } else if (!first) {
        now = law.moved_hysteresis(now, torsion - state.torsion_last[j]);
    }
    RateFilters filters{state.joint_filter_last[j], state.joint_filter_rate[j], state.motor_filter_last[j],
                        state.motor_filter_rate[j]};
    if (p.rate_source[0] == kErrorFilter) put_lag_back(law, filters, want, spring, m, first, T);
    out.position_error[j] = m.joint - want.r;
    double h = now;
    const double ahead = p.prediction_samples[0] * T;
    if (ahead > 0.0 && !first) law.predict(m, h, state.motor_torque_last[j], want, ahead);
    decide(law, m, h, ahead > 0.0 ? want.later(ahead) : want, out);
    if (!std::isfinite(out.motor_torque[j]) || !std::isfinite(now)) return;
    state.started[j] = 1.0;
    state.hysteresis_torque[j] = now;
    state.torsion_last[j] = torsion;
    state.motor_torque_last[j] = out.motor_torque[j];
    state.spring_torque_last[j] = spring.torque;
    state.wanted_torsion[j] = spring.torsion;
    state.joint_filter_last[j] = filters.joint_last, state.joint_filter_rate[j] = filters.joint_rate;
    state.motor_filter_last[j] = filters.motor_last, state.motor_filter_rate[j] = filters.motor_rate;
}

inline void manifold_step(const ManifoldParams& p, ManifoldState& state, const TorqueSample& in,
                          const ManifoldReference& ref, ManifoldOutput& out, int joints, double T) {
    for (int j = 0; j < joints; ++j) manifold_joint(p, state, in, wanted(ref, j), out, j, T);
}

// Reference of the chain: position, velocity and required torque. Their derivatives are backward differences of the
// highest order that the history allows; they are exact for the polynomial that the trajectory is made of.
inline Wanted wanted_from_history(const ManifoldParams& p, ManifoldState& state, const TorqueReference& ref, int j,
                                  double T) {
    const double v = ref.desired_velocity[j], L = ref.joint_torque_required[j];
    if (state.started[j] == 0.0) {
        state.velocity_1[j] = state.velocity_2[j] = state.velocity_3[j] = v;
        state.required_1[j] = state.required_2[j] = L;
    }
    const double v1 = state.velocity_1[j], v2 = state.velocity_2[j], v3 = state.velocity_3[j];
    const double L1 = state.required_1[j], L2 = state.required_2[j];
    Wanted w{ref.desired_position[j],
             v,
             (11 * v - 18 * v1 + 9 * v2 - 2 * v3) / (6 * T),
             (2 * v - 5 * v1 + 4 * v2 - v3) / (T * T),
             (v - 3 * v1 + 3 * v2 - v3) / (T * T * T),
             0.0,
             0.0,
             0.0};
    if (p.load_source[0] == 0.0) {
        const double c = std::cos(w.r), s = std::sin(w.r);
        const double slope = p.load_sine[j] * c - p.load_cosine[j] * s,
                     bend = -(p.load_cosine[j] * c + p.load_sine[j] * s);
        w.load = p.load_constant[j] - bend;
        w.load1 = slope * w.r1;
        w.load2 = slope * w.r2 + bend * w.r1 * w.r1;
    } else {
        w.load = L;
        w.load1 = (3 * L - 4 * L1 + L2) / (2 * T);
        w.load2 = (L - 2 * L1 + L2) / (T * T);
    }
    if (std::isfinite(v) && std::isfinite(L)) {
        state.velocity_3[j] = v2, state.velocity_2[j] = v1, state.velocity_1[j] = v;
        state.required_2[j] = L1, state.required_1[j] = L;
    }
    return w;
}

inline void manifold_chain_step(const ManifoldParams& p, ManifoldState& state, const TorqueSample& in,
                                const TorqueReference& ref, ManifoldOutput& out, int joints, double T) {
    for (int j = 0; j < joints; ++j) manifold_joint(p, state, in, wanted_from_history(p, state, ref, j, T), out, j, T);
}

}  // namespace hd
