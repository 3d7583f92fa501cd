// The blocks of the torque law: parameters, sample, reference, memory and output. Words to letters:
// torque_adaptive.hpp.
#pragma once

#include <cmath>

#include "blocks.hpp"

namespace hd {

#define HD_TORQUE_PARAMS(FIELD)                                                                           \
    FIELD(law, 0, "-", "0 adaptive, 1 direct")                                                            \
    FIELD(compliance_derivative, 0, "-", "0 literal, 1 stiffness_only, 2 filtered")                       \
    FIELD(rate_source, 0, "-", "0 plain, 1 error_filter")                                                 \
    FIELD(kinematic_feedforward, 0, "-", "1: take the known kinematic error off the wanted rotor motion") \
    FIELD(adapt_friction, 0, "-", "1: friction estimates follow the error")                               \
    FIELD(adapt_compliance, 0, "-", "1: the compliance estimate follows the error")                       \
    FIELD(derivative_pole, 0, "-", "pole of the derivative filter D")                                     \
    FIELD(gear_ratio, 1, "-", "rotor turns per joint turn")                                               \
    FIELD(damping_time, 1, "s", "flexspline damping over stiffness")                                      \
    FIELD(rotor_inertia, 1, "kg m^2", "rotor inertia, output side")                                       \
    FIELD(motor_position_gain, 1, "1/s", "lambda_phi")                                                    \
    FIELD(torque_rate_gain, 1, "1/(N m s)", "lambda_tau")                                                 \
    FIELD(motor_velocity_gain, 1, "N m s", "k_phi")                                                       \
    FIELD(torque_gain, 1, "-", "k_tau")                                                                   \
    FIELD(load_friction_linear, 1, "1/(N m)", "growth of Coulomb friction with load")                     \
    FIELD(load_friction_quadratic, 1, "1/(N m)^2", "growth of Coulomb friction with load squared")        \
    FIELD(adaptation_gain_coulomb, 1, "N m", "rho_1 times adaptation_scale")                              \
    FIELD(adaptation_gain_offset, 1, "N m", "rho_2")                                                      \
    FIELD(adaptation_gain_viscous, 1, "N m s^2", "rho_3 = rho_4 times adaptation_scale")                  \
    FIELD(adaptation_gain_compliance, 1, "1/(N m)^2", "rho_zeta times adaptation_scale")                  \
    FIELD(coulomb_torque_low, 1, "N m", "bound of the estimate")                                          \
    FIELD(coulomb_torque_high, 1, "N m", "bound of the estimate")                                         \
    FIELD(coulomb_torque_initial, 1, "N m", "start of the estimate")                                      \
    FIELD(friction_offset_low, 1, "N m", "bound of the estimate")                                         \
    FIELD(friction_offset_high, 1, "N m", "bound of the estimate")                                        \
    FIELD(friction_offset_initial, 1, "N m", "start of the estimate")                                     \
    FIELD(viscous_low, 1, "N m s", "bound of both estimates")                                             \
    FIELD(viscous_high, 1, "N m s", "bound of both estimates")                                            \
    FIELD(viscous_positive_initial, 1, "N m s", "start of the estimate")                                  \
    FIELD(viscous_negative_initial, 1, "N m s", "start of the estimate")                                  \
    FIELD(torsional_compliance_low, 1, "rad/(N m)", "bound of the estimate")                              \
    FIELD(torsional_compliance_high, 1, "rad/(N m)", "bound of the estimate")                             \
    FIELD(torsional_compliance_initial, 1, "rad/(N m)", "start of the estimate")                          \
    FIELD(motor_torque_limit, 1, "N m", "largest motor torque, output side")                              \
    FIELD(kinematic_cosine, 4, "rad", "kinematic error, cos n theta_m, n = 1 .. 4")                       \
    FIELD(kinematic_sine, 4, "rad", "kinematic error, sin n theta_m, n = 1 .. 4")

#define HD_TORQUE_SAMPLE(FIELD)                                      \
    FIELD(joint_position, 1, "rad", "q")                             \
    FIELD(joint_velocity, 1, "rad/s", "D(q)")                        \
    FIELD(joint_torque, 1, "N m", "tau, flexspline torque")          \
    FIELD(motor_position, 1, "rad", "phi, rotor angle / gear ratio") \
    FIELD(motor_velocity, 1, "rad/s", "D(phi)")                      \
    FIELD(motor_torque, 1, "N m", "motor torque applied, output side; recorded, not used by the law")

#define HD_TORQUE_REFERENCE(FIELD)                                             \
    FIELD(joint_torque_required, 1, "N m", "tau_r, from the motion law")       \
    FIELD(desired_position, 1, "rad", "q_d; used by rate_source error_filter") \
    FIELD(desired_velocity, 1, "rad/s", "q_d'; used by error_filter and kinematic_feedforward")

#define HD_TORQUE_STATE(FIELD)                                                              \
    FIELD(started, 1, "-", "1 after the first usable sample")                               \
    FIELD(joint_velocity_last, 1, "rad/s", "joint velocity of the last sample")             \
    FIELD(joint_acceleration, 1, "rad/s^2", "D of the joint velocity")                      \
    FIELD(joint_torque_last, 1, "N m", "joint torque of the last sample")                   \
    FIELD(joint_torque_rate, 1, "N m/s", "D of the joint torque")                           \
    FIELD(required_torque_last, 1, "N m", "required torque of the last sample")             \
    FIELD(required_torque_rate, 1, "N m/s", "D of the required torque")                     \
    FIELD(desired_velocity_last, 1, "rad/s", "desired velocity of the last sample")         \
    FIELD(desired_slope_last, 1, "rad/s^2", "last backward difference of desired velocity") \
    FIELD(joint_error_last, 1, "rad", "desired minus joint position, last sample")          \
    FIELD(joint_error_rate, 1, "rad/s", "D of it")                                          \
    FIELD(joint_error_acceleration, 1, "rad/s^2", "D of D of it")                           \
    FIELD(motor_error_last, 1, "rad", "desired minus motor position, last sample")          \
    FIELD(motor_error_rate, 1, "rad/s", "D of it")                                          \
    FIELD(desired_torsion, 1, "rad", "y by backward Euler")                                 \
    FIELD(desired_torsion_rate, 1, "rad/s", "D(y)")                                         \
    FIELD(raw_torsion_rate_last, 1, "rad/s", "last (y - y_old) / T")                        \
    FIELD(desired_torsion_acceleration, 1, "rad/s^2", "D of the raw rate of y")             \
    FIELD(torsional_compliance_last, 1, "rad/(N m)", "estimate used in the last sample")    \
    FIELD(coulomb_torque, 1, "N m", "estimate")                                             \
    FIELD(friction_offset, 1, "N m", "estimate")                                            \
    FIELD(viscous_positive, 1, "N m s", "estimate")                                         \
    FIELD(viscous_negative, 1, "N m s", "estimate")                                         \
    FIELD(torsional_compliance, 1, "rad/(N m)", "estimate")

#define HD_TORQUE_OUTPUT(FIELD)                                                                     \
    FIELD(motor_torque, 1, "N m", "u, output side: sum of the seven terms and saturation_torque")   \
    FIELD(inertia_torque, 1, "N m", "term: rotor_inertia required_motor_acceleration")              \
    FIELD(coulomb_feedforward, 1, "N m", "term: g(tau) sgn(required velocity) coulomb_torque")      \
    FIELD(offset_feedforward, 1, "N m", "term: friction_offset")                                    \
    FIELD(viscous_feedforward, 1, "N m", "term: viscous coefficient times required velocity")       \
    FIELD(velocity_feedback, 1, "N m", "term: motor_velocity_gain velocity_error")                  \
    FIELD(joint_torque_feedforward, 1, "N m", "term: required joint torque")                        \
    FIELD(torque_feedback, 1, "N m", "term: torque_gain joint_torque_error")                        \
    FIELD(saturation_torque, 1, "N m", "what motor_torque_limit took off")                          \
    FIELD(desired_torsion, 1, "rad", "y")                                                           \
    FIELD(desired_torsion_rate, 1, "rad/s", "y'")                                                   \
    FIELD(desired_torsion_acceleration, 1, "rad/s^2", "y''")                                        \
    FIELD(kinematic_error, 1, "rad", "KE taken off the desired motor position")                     \
    FIELD(kinematic_error_rate, 1, "rad/s", "its rate at the reference velocity")                   \
    FIELD(kinematic_error_acceleration, 1, "rad/s^2", "its acceleration at the reference velocity") \
    FIELD(desired_motor_position, 1, "rad", "phi_d")                                                \
    FIELD(desired_motor_velocity, 1, "rad/s", "phi_d'")                                             \
    FIELD(desired_motor_acceleration, 1, "rad/s^2", "phi_d''")                                      \
    FIELD(required_motor_velocity, 1, "rad/s", "phi_r'")                                            \
    FIELD(required_motor_acceleration, 1, "rad/s^2", "phi_r''")                                     \
    FIELD(motor_position_error, 1, "rad", "phi_d - phi")                                            \
    FIELD(motor_velocity_error, 1, "rad/s", "phi_d' - phi'")                                        \
    FIELD(velocity_error, 1, "rad/s", "phi_r' - phi'")                                              \
    FIELD(joint_torque_error, 1, "N m", "tau_r - tau")                                              \
    FIELD(joint_velocity, 1, "rad/s", "joint velocity used")                                        \
    FIELD(joint_acceleration, 1, "rad/s^2", "joint acceleration used")                              \
    FIELD(motor_velocity, 1, "rad/s", "motor velocity used")                                        \
    FIELD(joint_torque_rate, 1, "N m/s", "D(tau)")                                                  \
    FIELD(required_torque_rate, 1, "N m/s", "D(tau_r)")                                             \
    FIELD(desired_acceleration, 1, "rad/s^2", "q_d'' from the desired velocity")                    \
    FIELD(friction_load_factor, 1, "-", "g(tau)")                                                   \
    FIELD(coulomb_torque, 1, "N m", "estimate used in this sample")                                 \
    FIELD(friction_offset, 1, "N m", "estimate used in this sample")                                \
    FIELD(viscous_positive, 1, "N m s", "estimate used in this sample")                             \
    FIELD(viscous_negative, 1, "N m s", "estimate used in this sample")                             \
    FIELD(torsional_compliance, 1, "rad/(N m)", "estimate used in this sample")                     \
    FIELD(coulomb_torque_drive, 1, "rad/s", "s_1 of the projection")                                \
    FIELD(compliance_drive, 1, "N m rad/s", "s_zeta of the projection")

HD_BLOCK(TorqueParams, HD_TORQUE_PARAMS)
HD_BLOCK(TorqueSample, HD_TORQUE_SAMPLE)
HD_BLOCK(TorqueReference, HD_TORQUE_REFERENCE)
HD_BLOCK(TorqueState, HD_TORQUE_STATE)
HD_BLOCK(TorqueOutput, HD_TORQUE_OUTPUT)

// The memory of one joint, by value, so that a step renews it as a whole or not at all.
#define HD_MEMBER(name, per_joint, unit, meaning) double name = 0.0;
struct TorqueMemory {
    HD_TORQUE_STATE(HD_MEMBER)
};
#undef HD_MEMBER

inline TorqueMemory load_memory(const TorqueState& state, int j) {
    TorqueMemory memory;
#define HD_LOAD(name, per_joint, unit, meaning) memory.name = state.name[j];
    HD_TORQUE_STATE(HD_LOAD)
#undef HD_LOAD
    return memory;
}

inline void store_memory(TorqueState& state, const TorqueMemory& memory, int j) {
#define HD_STORE(name, per_joint, unit, meaning) state.name[j] = memory.name;
    HD_TORQUE_STATE(HD_STORE)
#undef HD_STORE
}

inline bool is_finite(const TorqueMemory& memory) {
    double total = 0.0;  // x - x is 0 for a finite x and not a number otherwise
#define HD_ADD(name, per_joint, unit, meaning) total += memory.name - memory.name;
    HD_TORQUE_STATE(HD_ADD)
#undef HD_ADD
    return total == 0.0;
}

}  // namespace hd
