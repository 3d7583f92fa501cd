// The blocks of the integral-manifold law: parameters, reference, memory and output. Words to letters:
// integral_manifold.hpp.
#pragma once

#include "blocks.hpp"

namespace hd {

#define HD_MANIFOLD_PARAMS(FIELD)                                                                                 \
    FIELD(composition, 0, "-", "0 comparison (31), 1 tau_0, 2 and tau_1, 3 and tau_2, 4 all terms")               \
    FIELD(prediction_samples, 0, "-", "samples from the measurement to the middle of the command's hold")         \
    FIELD(load_source, 0, "-", "0 function of the wanted position, 1 required joint torque")                      \
    FIELD(error_filter, 0, "-", "1: measured rates carry the lag of D; what the wanted motion knows is put back") \
    FIELD(derivative_pole, 0, "-", "pole of the derivative filter D of the measured rates")                       \
    FIELD(hysteresis_source, 0, "-", "0 measured torsion, 1 wanted torque")                                       \
    FIELD(gear_ratio, 1, "-", "N")                                                                                \
    FIELD(torsional_stiffness, 1, "N m/rad", "K")                                                                 \
    FIELD(stiffness_cubic, 1, "N m/rad^3", "m_2")                                                                 \
    FIELD(stiffness_quintic, 1, "N m/rad^5", "m_3")                                                               \
    FIELD(rotor_inertia, 1, "kg m^2", "N^2 J_m")                                                                  \
    FIELD(rotor_coulomb, 1, "N m", "Coulomb friction of the rotor, fed forward")                                  \
    FIELD(friction_speed, 1, "rad/s", "wanted speed at which 76 % of it are fed forward")                         \
    FIELD(rotor_damping, 1, "N m s", "N^2 B_m")                                                                   \
    FIELD(link_inertia, 1, "kg m^2", "J_l")                                                                       \
    FIELD(link_damping, 1, "N m s", "B_l")                                                                        \
    FIELD(hysteresis_stiffness, 1, "N m/rad", "A")                                                                \
    FIELD(hysteresis_rate, 1, "1/rad", "alpha")                                                                   \
    FIELD(perturbation_stiffness, 1, "N m/rad", "K_1")                                                            \
    FIELD(position_gain, 1, "1/s", "Lambda")                                                                      \
    FIELD(damping_gain, 1, "N m s", "k_d")                                                                        \
    FIELD(fast_gain, 1, "s", "K_D")                                                                               \
    FIELD(load_constant, 1, "N m", "load: constant part")                                                         \
    FIELD(load_cosine, 1, "N m", "load: with cos of the wanted position")                                         \
    FIELD(load_sine, 1, "N m", "load: with sin of the wanted position")                                           \
    FIELD(motor_torque_limit, 1, "N m", "largest motor torque, output side")                                      \
    FIELD(kinematic_cosine, 4, "rad", "kinematic error, cos n theta_m, n = 1 .. 4")                               \
    FIELD(kinematic_sine, 4, "rad", "kinematic error, sin n theta_m, n = 1 .. 4")

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

}  // namespace hd
