// Composite position control of one joint with known smooth load: Gandhi and Ghorbel (26)-(30), (31), corrected.
//
//   code                            paper             code                         paper
//   rotor_, link_ (angles, rates)   theta_m, theta_l  Yp, p2, p3                   Y_p, theta_p'', theta_p'''
//   torsional_stiffness             K                 manifold_torque              h_0
//   perturbation_stiffness          K_1               hysteresis_torque            -q
//   epsilon                         sqrt(K_1 / K)     load_torque                  tau_l
//   position_gain, damping_gain     Lambda, k_d       fast_gain                    K_D
//
// Blocks are output side (torques x N, inertias x N^2); inside, the paper's motor side. The kinematic error of a block
// is -theta_p. The hysteresis torque is the law's own, moved by the measured torsion along its exact solution.
#pragma once

#include <algorithm>
#include <cmath>

#include "integral_manifold_blocks.hpp"
#include "torque_blocks.hpp"

namespace hd {

constexpr int kGearHarmonics = 4;
constexpr double kPredictionStep = 2.5e-4;  // s, longest Runge-Kutta step of the prediction

struct Transmission {
    double value = 0.0, slope = 0.0, curvature = 0.0, third = 0.0;
};

// Kinematic error of the blocks and its derivatives with respect to the rotor angle.
inline Transmission transmission(double angle, const double* cosine, const double* sine) {
    Transmission t;
    for (int i = 0; i < kGearHarmonics; ++i) {
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

    const double* cosine() const { return &p.kinematic_cosine[kGearHarmonics * j]; }
    const double* sine() const { return &p.kinematic_sine[kGearHarmonics * j]; }

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

    // At the start the gauge tells it, within what the hysteresis can hold.
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
        return {m.motor_rate, (u - Y * torque - p.rotor_damping[j] * m.motor_rate - friction) / p.rotor_inertia[j], m.joint_rate,
                (torque - load - p.link_damping[j] * m.joint_rate) / p.link_inertia[j]};
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
        const double Lambda = p.position_gain[j], KD = p.fast_gain[j], eps = std::sqrt(K1 / K), q = -h;
        const Transmission t = transmission(N * m.motor, cosine(), sine());
        const double Yp = 1.0 / N + t.slope, p2 = -t.curvature, p3 = -t.third;
        const double v = m.joint_rate, rotor_rate = N * m.motor_rate;
        const double e = m.joint - w.r, e1 = v - w.r1, sum = e1 + Lambda * e;
        const double D = Jm / (Yp * Yp) + Jl, c = Jm * p2 / (Yp * Yp * Yp), c4 = c / Yp;
        const double tau0 =
            Yp * (D * (w.r2 - Lambda * e1) + (c4 * v + Bl) * (w.r1 - Lambda * e) - p.damping_gain[j] * sum + w.load);
        const double Gamma = (c4 * v + Bl + p.damping_gain[j]) / D, accel = w.r2 - Lambda * e1 - Gamma * sum;
        const double e2 = accel - w.r2, slow_rate = v / Yp;
        const double Yp_rate = -p2 * slow_rate, D_rate = -2.0 * Jm * Yp_rate / (Yp * Yp * Yp);
        const double c4_rate = Jm * p3 * slow_rate / std::pow(Yp, 4) - 4.0 * Jm * p2 * Yp_rate / std::pow(Yp, 5);
        const double Gamma_rate = (c4_rate * v + c4 * accel) / D - Gamma * D_rate / D;
        const double jerk = w.r3 - Lambda * e2 - Gamma * (e2 + Lambda * e1) - Gamma_rate * sum;
        const double s1 = Jl * jerk + Bl * accel + w.load1, s2 = Jl * w.r4 + Bl * jerk + w.load2;
        const double side = s1 > 0.0 ? 1.0 : (s1 < 0.0 ? -1.0 : 0.0), alpha = p.hysteresis_rate[j];
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
        const double N = p.gear_ratio[j], K = p.torsional_stiffness[j], Lambda = p.position_gain[j];
        const double e = m.joint - w.r, e1 = m.joint_rate - w.r1;
        const double fast = p.fast_gain[j] * std::sqrt(p.perturbation_stiffness[j] / K) * K;
        out.damping_term[j] = p.rotor_damping[j] * m.motor_rate;
        out.friction_term[j] = friction(w.r1);
        out.fast_term[j] = N * fast * (m.joint_rate - m.motor_rate);
        out.slow_term_0[j] = (p.link_inertia[j] + p.rotor_inertia[j]) * (w.r2 - Lambda * e1) +
                             p.link_damping[j] * (w.r1 - Lambda * e) - p.damping_gain[j] * (e1 + Lambda * e) + w.load;
        out.slow_term_1[j] = out.slow_term_2[j] = out.slow_term_4[j] = 0.0;
    }
};

}  // namespace hd
