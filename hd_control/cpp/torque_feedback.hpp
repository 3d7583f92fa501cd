// Joint torque control by torque feedback: Hashimoto (19), with integral term and friction feed-forward. Output side.
//
//   code                            paper        code                                      paper
//   joint_torque, .._required       T_J, T_d     rotor_inertia, link_inertia               J = N^2 J_M, J_L
//   torsional_stiffness             K            proportional_gain, rate_gain, integral  K_p, K_d, K_i (paper: 0)
//   motor_torque                    N tau_M
#pragma once

#include <algorithm>
#include <cmath>

#include "blocks.hpp"
#include "law_math.hpp"
#include "torque_adaptive.hpp"

namespace hd {

#define HD_FEEDBACK_PARAMS(FIELD)                                                                                   \
    FIELD(setpoint_kick, 0, "-", "rates of the required torque by difference", truth())                             \
    FIELD(torque_rate_cutoff, 0, "rad/s", "cut-off of the filter on the joint torque's rate", above(0.0, 1e5))      \
    HD_ROTOR_INERTIA(FIELD)                                                                                         \
    HD_LINK_INERTIA(FIELD)                                                                                          \
    HD_TORSIONAL_STIFFNESS(FIELD)                                                                                   \
    FIELD(feedback_proportional, 1, "1/s^2", "torque error to torque acceleration", at_least(0.0).times(2.0))       \
    FIELD(feedback_rate, 1, "1/s", "torque rate error to torque acceleration", at_least(0.0).times(2.0))            \
    FIELD(feedback_integral, 1, "1/s^3", "integral of the torque error; 0 in the paper",                            \
          at_least(0.0).times(4.0).within(1e4))                                                                     \
    FIELD(feedback_integral_limit, 1, "N m", "largest integral term", at_least(0.0).times(4.0))                     \
    FIELD(feedback_friction, 1, "N m", "Coulomb friction fed forward, output side",                                 \
          at_least(0.0).times(2.0).within(0.1))                                                                     \
    FIELD(feedback_friction_rate, 1, "N m/s",                                                                       \
          "rate of the required torque at which 76 % of feedback_friction are fed forward", above(0.0).times(10.0)) \
    HD_MOTOR_TORQUE_LIMIT(FIELD)

#define HD_FEEDBACK_REFERENCE(FIELD)                \
    FIELD(joint_torque_required, 1, "N m", "T_d")   \
    FIELD(required_torque_rate, 1, "N m/s", "T_d'") \
    FIELD(required_torque_acceleration, 1, "N m/s^2", "T_d''")

#define HD_FEEDBACK_STATE(FIELD)                                                \
    FIELD(started, 1, "-", "1 after the first usable sample")                   \
    FIELD(joint_torque_last, 1, "N m", "joint torque of the last sample")       \
    FIELD(joint_torque_rate, 1, "N m/s", "filtered rate of the joint torque")   \
    FIELD(integral, 1, "N m s", "integral of the torque error")                 \
    FIELD(required_torque_last, 1, "N m", "required torque of the last sample") \
    FIELD(required_rate_last, 1, "N m/s", "its rate of the last sample")

#define HD_FEEDBACK_OUTPUT(FIELD)                                                           \
    FIELD(motor_torque, 1, "N m", "u, output side: sum of the terms and saturation_torque") \
    FIELD(acceleration_term, 1, "N m", "term: J/K T_d''")                                   \
    FIELD(rate_term, 1, "N m", "term: J/K K_d (T_d' - T_J')")                               \
    FIELD(proportional_term, 1, "N m", "term: J/K K_p (T_d - T_J)")                         \
    FIELD(integral_term, 1, "N m", "term: J/K K_i integral of T_d - T_J")                   \
    FIELD(feedforward_term, 1, "N m", "term: T_d (1 + J/J_L)")                              \
    FIELD(friction_term, 1, "N m", "term: friction fed forward in the sense of T_d'")       \
    FIELD(saturation_torque, 1, "N m", "what motor_torque_limit took off")                  \
    FIELD(joint_torque_error, 1, "N m", "T_d - T_J")                                        \
    FIELD(joint_torque_rate, 1, "N m/s", "T_J'")                                            \
    FIELD(required_torque_rate, 1, "N m/s", "T_d'")

HD_BLOCK(FeedbackParams, HD_FEEDBACK_PARAMS)
HD_BLOCK(FeedbackReference, HD_FEEDBACK_REFERENCE)
HD_BLOCK(FeedbackState, HD_FEEDBACK_STATE)
HD_BLOCK(FeedbackOutput, HD_FEEDBACK_OUTPUT)

struct RequiredTorque {
    double torque, rate, acceleration;
};

// One joint, one sample. A joint whose inputs give no finite torque says so and keeps its memory as it was.
inline void feedback_joint(const FeedbackParams& p, FeedbackState& state, double joint_torque,
                           const RequiredTorque& want, FeedbackOutput& out, int j, double T) {
    double last = state.joint_torque_last[j], rate = state.joint_torque_rate[j];
    if (state.started[j] == 0.0) last = joint_torque, rate = 0.0;
    differentiate(joint_torque, last, rate, derivative_pole(p.torque_rate_cutoff[0], T), T);
    const double error = want.torque - joint_torque, per = p.rotor_inertia[j] / p.torsional_stiffness[j];
    const double weight = per * p.feedback_integral[j], limit = p.feedback_integral_limit[j];
    double integral = state.integral[j] + T * error;
    if (weight > 0.0) integral = std::min(std::max(integral, -limit / weight), limit / weight);
    const double share = p.link_inertia[j] > 0.0 ? p.rotor_inertia[j] / p.link_inertia[j] : 0.0;
    out.joint_torque_error[j] = error;
    out.joint_torque_rate[j] = rate;
    out.required_torque_rate[j] = want.rate;
    out.acceleration_term[j] = per * want.acceleration;
    out.rate_term[j] = per * p.feedback_rate[j] * (want.rate - rate);
    out.proportional_term[j] = per * p.feedback_proportional[j] * error;
    out.integral_term[j] = weight * integral;
    out.feedforward_term[j] = want.torque * (1.0 + share);
    out.friction_term[j] = p.feedback_friction[j] * std::tanh(want.rate / p.feedback_friction_rate[j]);
    const double u = out.acceleration_term[j] + out.rate_term[j] + out.proportional_term[j] + out.integral_term[j] +
                     out.feedforward_term[j] + out.friction_term[j];
    const double most = p.motor_torque_limit[j];
    out.motor_torque[j] = u != u ? u : std::min(std::max(u, -most), most);
    out.saturation_torque[j] = out.motor_torque[j] - u;
    if (!std::isfinite(u)) return;
    state.started[j] = 1.0;
    state.joint_torque_last[j] = last;
    state.joint_torque_rate[j] = rate;
    // At the drive's limit the integral only moves back.
    if (out.saturation_torque[j] * error >= 0.0) state.integral[j] = integral;
}

inline void feedback_step(const FeedbackParams& p, FeedbackState& state, const TorqueSample& in,
                          const FeedbackReference& ref, FeedbackOutput& out, int joints, double T) {
    for (int j = 0; j < joints; ++j) {
        const RequiredTorque want{ref.joint_torque_required[j], ref.required_torque_rate[j],
                                  ref.required_torque_acceleration[j]};
        feedback_joint(p, state, in.joint_torque[j], want, out, j, T);
    }
}

// Reference of the chain: the required torque alone; with `setpoint_kick` its rates are differences.
inline void feedback_chain_step(const FeedbackParams& p, FeedbackState& state, const TorqueSample& in,
                                const TorqueReference& ref, FeedbackOutput& out, int joints, double T) {
    for (int j = 0; j < joints; ++j) {
        RequiredTorque want{ref.joint_torque_required[j], 0.0, 0.0};
        if (p.setpoint_kick[0] != 0.0 && state.started[j] != 0.0) {
            want.rate = (want.torque - state.required_torque_last[j]) / T;
            want.acceleration = (want.rate - state.required_rate_last[j]) / T;
        }
        feedback_joint(p, state, in.joint_torque[j], want, out, j, T);
        if (!std::isfinite(out.motor_torque[j])) continue;
        state.required_torque_last[j] = want.torque;
        state.required_rate_last[j] = want.rate;
    }
}

}  // namespace hd
