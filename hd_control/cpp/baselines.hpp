// Laws to compare with: they command the motor directly, without a torque loop and without friction compensation.
//
//     pd               u = G(q) + k_p [(dot q_d - dot q) + lambda (q_d - q)]
//     pid              u = pd + bounded integral of the same bracket, gain k_I
//     computed_torque  u = M(q) a_c + C(q, dot q) dot q + G(q) + I* a_c,
//                      a_c = ddot q_d + 2 lambda (dot q_d - dot q) + lambda^2 (q_d - q)
//     feed_forward     u = M(q_d) ddot q_d + C dot q_d + G(q_d) + I* ddot q_d, no feedback
//
// M, C and G are made from the link parameters at the start (wrong on purpose when link_parameter_scale is not 1).
#pragma once

#include "motion_vdc.hpp"

namespace hd {

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

}  // namespace hd
