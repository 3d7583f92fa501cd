// The blocks of the motion laws: what they read, remember and report.
#pragma once

#include "blocks.hpp"
#include "rigid_chain.hpp"

#define HD_MOTION_PARAMS(FIELD)                                                             \
    FIELD(law, 0, "-", "0 vdc, 1 pd, 2 pid, 3 computed_torque, 4 feed_forward")             \
    FIELD(rate_source, 0, "-", "joint velocity: 0 plain (from the sample), 1 error_filter") \
    FIELD(derivative_cutoff, 0, "rad/s", "cutoff of the error filter")                      \
    FIELD(link_adaptation, 0, "-", "1: link parameters adapt, 0: they stay")                \
    FIELD(gravity, 0, "m/s^2", "upward acceleration of the base that stands for gravity")   \
    FIELD(rotation, 9, "-", "fixed rotation of each joint frame in the previous one, rows") \
    FIELD(origin, 3, "m", "origin of each joint frame in the previous one")                 \
    FIELD(link_parameters, 13, "kg, kg m, kg m^2", "link parameters at the start")          \
    FIELD(link_parameters_low, 13, "kg, kg m, kg m^2", "lower bounds of adaptation")        \
    FIELD(link_parameters_high, 13, "kg, kg m, kg m^2", "upper bounds of adaptation")       \
    FIELD(link_adaptation_gain, 13, "parameter unit / (N m rad)", "adaptation gains")       \
    FIELD(position_gain, 1, "1/s", "position error to required velocity")                   \
    FIELD(velocity_gain, 1, "N m s", "feedback of the required velocity error")             \
    FIELD(integral_gain, 1, "N m", "bounded integral of the required velocity error")       \
    FIELD(integral_low, 1, "N m", "lower bound of the integral")                            \
    FIELD(integral_high, 1, "N m", "upper bound of the integral")                           \
    FIELD(rotor_inertia, 1, "kg m^2", "rotor inertia, output side, for the laws that command the motor")

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

namespace hd {

HD_BLOCK(MotionParams, HD_MOTION_PARAMS)
HD_BLOCK(MotionState, HD_MOTION_STATE)
HD_BLOCK(MotionSample, HD_MOTION_SAMPLE)
HD_BLOCK(MotionReference, HD_MOTION_REFERENCE)
HD_BLOCK(MotionOutput, HD_MOTION_OUTPUT)

enum class MotionLaw { vdc, pd, pid, computed_torque, feed_forward };

inline Chain chain_of(const MotionParams& params, int joints) {
    return {joints, params.rotation, params.origin, *params.gravity};
}

}  // namespace hd
