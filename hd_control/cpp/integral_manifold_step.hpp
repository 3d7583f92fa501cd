// One sample of the integral-manifold law: what it takes from the measurement, from the wanted motion and from the
// chain. Terms of the law: integral_manifold.hpp.
//
// With `error_filter` the measured rates, which carry the lag of the filter D, get back what D takes off the wanted
// motion. The wanted rotor moves against the kinematic error and winds the spring, so that its rate is known as well.
#pragma once

#include "derivative.hpp"
#include "integral_manifold.hpp"

namespace hd {

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
    const double N = law.p.gear_ratio[law.j], pole = law.p.derivative_pole[0];
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
    if (p.error_filter[0] != 0.0) put_lag_back(law, filters, want, spring, m, first, T);
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
