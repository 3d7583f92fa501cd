// The motion laws: blocks, virtual decomposition control, laws to compare with, one sample.
#pragma once

#include <algorithm>
#include <cmath>

#include "blocks.hpp"
#include "law_math.hpp"
#include "rigid_chain.hpp"

namespace hd {

#define HD_MOTION_PARAMS(FIELD)                                                                                 \
    FIELD(law, 0, "-", "motion law", one_of("vdc pd pid computed_torque feed_forward"))                         \
    HD_RATE_SOURCE(FIELD)                                                                                       \
    HD_DERIVATIVE_CUTOFF(FIELD)                                                                                 \
    FIELD(position_gain, 1, "1/s", "position error to required velocity", above(0.0).times(4.0))                \
    FIELD(velocity_gain, 1, "N m s", "feedback of the required velocity error", above(0.0).times(2.0))          \
    FIELD(integral_gain, 1, "N m", "bounded integral of the required velocity error", at_least(0.0).times(4.0)) \
    FIELD(integral_low, 1, "N m", "lower bound of the integral", any().times(2.0).within(0.05))                 \
    FIELD(integral_high, 1, "N m", "upper bound of the integral", any().times(2.0).within(0.05))                \
    FIELD(rotor_inertia, 1, "kg m^2", "rotor inertia, output side (computed_torque, feed_forward)",             \
          at_least(0.0).times(2.0))                                                                             \
    FIELD(link_adaptation, 0, "-", "whether link parameters adapt", truth())                                    \
    FIELD(gravity, 0, "m/s^2", "upward acceleration of the base that stands for gravity")                       \
    FIELD(rotation, 9, "-", "fixed rotation of each joint frame in the previous one, rows")                     \
    FIELD(origin, 3, "m", "origin of each joint frame in the previous one")                                     \
    FIELD(link_parameters, 13, "kg, kg m, kg m^2", "link parameters at the start")                              \
    FIELD(link_parameters_low, 13, "kg, kg m, kg m^2", "lower bounds of adaptation")                            \
    FIELD(link_parameters_high, 13, "kg, kg m, kg m^2", "upper bounds of adaptation")                           \
    FIELD(link_adaptation_gain, 13, "parameter unit / (N m rad)", "adaptation gains")

#define HD_MOTION_STATE(FIELD)                                                    \
    FIELD(started, 0, "-", "1 once the filter holds a sample")                    \
    FIELD(link_parameters, 13, "kg, kg m, kg m^2", "adapted link parameters")     \
    FIELD(integral, 1, "N m", "bounded integral")                                 \
    FIELD(last_position_error, 1, "rad", "position error of the previous sample") \
    FIELD(position_error_rate, 1, "rad/s", "filtered derivative of the position error")

#define HD_MOTION_SAMPLE(FIELD)                          \
    FIELD(joint_position, 1, "rad", "measured position") \
    FIELD(joint_velocity, 1, "rad/s", "filtered velocity")

#define HD_MOTION_REFERENCE(FIELD)                                     \
    FIELD(desired_position, 1, "rad", "wanted position")               \
    FIELD(desired_velocity, 1, "rad/s", "its first derivative")        \
    FIELD(desired_acceleration, 1, "rad/s^2", "its second derivative") \
    FIELD(feed_forward_torque, 1, "N m", "added to the output; zero unless a drive model supplies it")

#define HD_MOTION_OUTPUT(FIELD)                                                                           \
    FIELD(joint_torque_required, 1, "N m", "torque wanted at the joint (at the motor for the baselines)") \
    FIELD(desired_position, 1, "rad", "wanted position")                                                  \
    FIELD(desired_velocity, 1, "rad/s", "wanted velocity")                                                \
    FIELD(desired_acceleration, 1, "rad/s^2", "wanted acceleration")                                      \
    FIELD(required_velocity, 1, "rad/s", "desired velocity corrected by the position error")              \
    FIELD(required_acceleration, 1, "rad/s^2", "acceleration that the link torque is made for")           \
    FIELD(joint_velocity, 1, "rad/s", "velocity that the law used")                                       \
    FIELD(position_error, 1, "rad", "desired minus measured position")                                    \
    FIELD(required_velocity_error, 1, "rad/s", "required minus used velocity")                            \
    FIELD(link_torque, 1, "N m", "torque of the link model")                                              \
    FIELD(rotor_torque, 1, "N m", "torque for the rotor inertia; zero under vdc, pd and pid")             \
    FIELD(velocity_feedback, 1, "N m", "feedback of the required velocity error")                         \
    FIELD(integral, 1, "N m", "bounded integral")                                                         \
    FIELD(feed_forward_torque, 1, "N m", "as given with the reference")                                   \
    FIELD(integral_saturated, 1, "-", "1 when the integral is at a bound")                                \
    FIELD(link_parameters_at_bound, 1, "-", "how many of the link's adapted parameters are at a bound")   \
    FIELD(link_parameters, 13, "kg, kg m, kg m^2", "link parameters that the law used")

HD_BLOCK(MotionParams, HD_MOTION_PARAMS)
HD_BLOCK(MotionState, HD_MOTION_STATE)
HD_BLOCK(MotionSample, HD_MOTION_SAMPLE)
HD_BLOCK(MotionReference, HD_MOTION_REFERENCE)
HD_BLOCK(MotionOutput, HD_MOTION_OUTPUT)

enum class MotionLaw { vdc, pd, pid, computed_torque, feed_forward };

inline Chain chain_of(const MotionParams& params, int joints) {
    return {joints, params.rotation, params.origin, *params.gravity};
}

// Virtual decomposition control. Zhu (31)-(40).
//
//     dot q_r  required_velocity        lambda  position_gain    theta_L  link_parameters       psi  Y_L^T (X_r - X)
//     ddot q_r required_acceleration    k_p     velocity_gain    rho_L    link_adaptation_gain
//     P        bounded integral         k_I     integral_gain    t_s -+   integral_low, integral_high
//
// Order within a sample: the integral is renewed before it is used, the link parameters after the torque is made.

// k_p (dot q_r - dot q) and, if wanted, P. Zhu (40); the baselines use the same two terms.
inline void add_feedback(int joints, const MotionParams& params, bool with_integral, double dt, MotionOutput& out,
                         MotionState& next) {
    for (int j = 0; j < joints; ++j) {
        const double error = out.required_velocity_error[j];
        const double low = params.integral_low[j], high = params.integral_high[j];
        out.velocity_feedback[j] = params.velocity_gain[j] * error;
        if (!with_integral) continue;
        next.integral[j] = project(next.integral[j], error, params.integral_gain[j], low, high, dt);
        out.integral[j] = next.integral[j];
        out.integral_saturated[j] = next.integral[j] <= low || next.integral[j] >= high ? 1.0 : 0.0;
    }
}

// theta_L <- P(psi, rho_L, low, high). Zhu (38).
inline void adapt_links(int joints, const MotionParams& params, const double* psi, double dt, MotionState& next) {
    for (int i = 0; i < LINK_PARAMETERS * joints; ++i) {
        if (params.link_adaptation_gain[i] <= 0.0) continue;
        next.link_parameters[i] = project(next.link_parameters[i], psi[i], params.link_adaptation_gain[i],
                                          params.link_parameters_low[i], params.link_parameters_high[i], dt);
    }
}

inline void count_bounds(int joints, const MotionParams& params, MotionOutput& out) {
    for (int i = 0; i < LINK_PARAMETERS * joints; ++i) {
        const bool adapts = params.link_adaptation_gain[i] > 0.0;
        const bool at_bound = out.link_parameters[i] <= params.link_parameters_low[i] ||
                              out.link_parameters[i] >= params.link_parameters_high[i];
        if (adapts && at_bound) out.link_parameters_at_bound[i / LINK_PARAMETERS] += 1.0;
    }
}

inline void step_vdc(int joints, const MotionParams& params, const double* position, double dt, MotionOutput& out,
                     MotionState& next) {
    double psi[MAX_JOINTS * LINK_PARAMETERS];
    for (int j = 0; j < joints; ++j) {  // Zhu (32)
        out.required_acceleration[j] =
            out.desired_acceleration[j] + params.position_gain[j] * (out.desired_velocity[j] - out.joint_velocity[j]);
    }
    rigid_torque(chain_of(params, joints), next.link_parameters, position, out.joint_velocity, out.required_velocity,
                 out.required_acceleration, out.link_torque, psi);
    add_feedback(joints, params, true, dt, out, next);
    count_bounds(joints, params, out);
    if (*params.link_adaptation > 0.0) adapt_links(joints, params, psi, dt, next);
}

// Laws to compare with: they command the motor directly, without a torque loop and without friction compensation.
//
//     pd               u = G(q) + k_p [(dot q_d - dot q) + lambda (q_d - q)]
//     pid              u = pd + bounded integral of the same bracket, gain k_I
//     computed_torque  u = M(q) a_c + C(q, dot q) dot q + G(q) + I* a_c,
//                      a_c = ddot q_d + 2 lambda (dot q_d - dot q) + lambda^2 (q_d - q)
//     feed_forward     u = M(q_d) ddot q_d + C dot q_d + G(q_d) + I* ddot q_d, no feedback
//
// M, C and G are made from the link parameters at the start (wrong on purpose when link_parameter_scale is not 1).

inline void step_gravity_and_feedback(int joints, const MotionParams& params, const double* position,
                                      bool with_integral, double dt, MotionOutput& out, MotionState& next) {
    const double rest[MAX_JOINTS] = {};
    rigid_torque(chain_of(params, joints), next.link_parameters, position, rest, rest, rest, out.link_torque, nullptr);
    add_feedback(joints, params, with_integral, dt, out, next);
}

inline void add_rotor(int joints, const MotionParams& params, MotionOutput& out) {
    for (int j = 0; j < joints; ++j) out.rotor_torque[j] = params.rotor_inertia[j] * out.required_acceleration[j];
}

inline void step_computed_torque(int joints, const MotionParams& params, const double* position, MotionOutput& out,
                                 MotionState& next) {
    for (int j = 0; j < joints; ++j) {
        const double gain = params.position_gain[j];
        const double rate_error = out.desired_velocity[j] - out.joint_velocity[j];
        out.required_acceleration[j] =
            out.desired_acceleration[j] + 2.0 * gain * rate_error + gain * gain * out.position_error[j];
    }
    rigid_torque(chain_of(params, joints), next.link_parameters, position, out.joint_velocity, out.joint_velocity,
                 out.required_acceleration, out.link_torque, nullptr);
    add_rotor(joints, params, out);
}

inline void step_feed_forward(int joints, const MotionParams& params, MotionOutput& out, MotionState& next) {
    for (int j = 0; j < joints; ++j) out.required_acceleration[j] = out.desired_acceleration[j];
    rigid_torque(chain_of(params, joints), next.link_parameters, out.desired_position, out.desired_velocity,
                 out.desired_velocity, out.desired_acceleration, out.link_torque, nullptr);
    add_rotor(joints, params, out);
}

// One sample of a motion law: reference, errors and velocity, then the law, then the sum of its terms.

// Reference, errors and the joint velocity that the law uses: the sample's, or by the error filter
// dot q = dot q_d - D(q_d - q), which differentiates the error and adds the known rate back.
inline void prepare(int joints, const MotionParams& params, const MotionSample& sample,
                    const MotionReference& reference, double dt, MotionOutput& out, MotionState& next) {
    const double pole = derivative_pole(*params.derivative_cutoff, dt);
    const bool error_filter = *params.rate_source > 0.0;
    for (int j = 0; j < joints; ++j) {
        const double error = reference.desired_position[j] - sample.joint_position[j];
        if (!(*next.started > 0.0)) next.last_position_error[j] = error;
        const double error_rate =
            differentiate(error, next.last_position_error[j], next.position_error_rate[j], pole, dt);
        out.desired_position[j] = reference.desired_position[j];
        out.desired_velocity[j] = reference.desired_velocity[j];
        out.desired_acceleration[j] = reference.desired_acceleration[j];
        out.feed_forward_torque[j] = reference.feed_forward_torque[j];
        out.position_error[j] = error;
        out.joint_velocity[j] = error_filter ? reference.desired_velocity[j] - error_rate : sample.joint_velocity[j];
        out.required_velocity[j] = reference.desired_velocity[j] + params.position_gain[j] * error;  // Zhu (31)
        out.required_velocity_error[j] = out.required_velocity[j] - out.joint_velocity[j];
    }
    *next.started = 1.0;
}

inline void run_law(int joints, const MotionParams& params, const double* position, double dt, MotionOutput& out,
                    MotionState& next) {
    switch (static_cast<MotionLaw>(static_cast<int>(*params.law))) {
        case MotionLaw::pd:
            return step_gravity_and_feedback(joints, params, position, false, dt, out, next);
        case MotionLaw::pid:
            return step_gravity_and_feedback(joints, params, position, true, dt, out, next);
        case MotionLaw::computed_torque:
            return step_computed_torque(joints, params, position, out, next);
        case MotionLaw::feed_forward:
            return step_feed_forward(joints, params, out, next);
        case MotionLaw::vdc:
            return step_vdc(joints, params, position, dt, out, next);
    }
}

// Flat arrays of state, output and next state, which may not overlap. Without a finite torque the state stays.
inline void motion_step(const MotionParams& params, const double* state, const MotionSample& sample,
                        const MotionReference& reference, double* output, double* next_state, int joints, double dt) {
    const std::size_t size = MotionState::size(joints);
    std::copy(state, state + size, next_state);
    std::fill(output, output + MotionOutput::size(joints), 0.0);
    MotionOutput out(output, joints);
    MotionState next(next_state, joints);
    prepare(joints, params, sample, reference, dt, out, next);
    std::copy(next.link_parameters, next.link_parameters + LINK_PARAMETERS * joints, out.link_parameters);
    run_law(joints, params, sample.joint_position, dt, out, next);
    bool finite = true;
    for (int j = 0; j < joints; ++j) {
        out.joint_torque_required[j] = out.link_torque[j] + out.rotor_torque[j] + out.velocity_feedback[j] +
                                       out.integral[j] + out.feed_forward_torque[j];
        finite = finite && std::isfinite(out.joint_torque_required[j]);
    }
    if (!finite) std::copy(state, state + size, next_state);
}

}  // namespace hd
