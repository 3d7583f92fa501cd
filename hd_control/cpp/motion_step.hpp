// One sample of a motion law: reference, errors and velocity, then the law, then the sum of its terms.
#pragma once

#include <algorithm>
#include <cmath>

#include "baselines.hpp"
#include "derivative.hpp"
#include "motion_blocks.hpp"
#include "motion_vdc.hpp"

namespace hd {

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
