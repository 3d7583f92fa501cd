// Virtual decomposition control. Zhu (31)-(40).
//
//     dot q_r  required_velocity        lambda  position_gain    theta_L  link_parameters       psi  Y_L^T (X_r - X)
//     ddot q_r required_acceleration    k_p     velocity_gain    rho_L    link_adaptation_gain
//     P        bounded integral         k_I     integral_gain    t_s -+   integral_low, integral_high
//
// Order within a sample: the integral is renewed before it is used, the link parameters after the torque is made.
#pragma once

#include "motion_blocks.hpp"
#include "projection.hpp"

namespace hd {

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

}  // namespace hd
