// Adaptive joint torque control. Zhu, section III, corrected: docs/equations/adaptive_torque_law.md (D1)-(D11).
//
//   code                                  paper       code                             paper
//   joint_torque, joint_torque_required   tau, tau_r  desired_torsion                  y = F zeta^ tau_r   Zhu (5)
//   motor_position, motor_velocity        phi, phi'   desired_motor_position           phi_d               Zhu (7)
//   joint_position, joint_velocity        q, q'       required_motor_velocity          phi'_r              Zhu (8)
//   motor_position_gain, torque_rate_gain lambda_phi, lambda_tau
//   motor_velocity_gain, torque_gain      k_phi, k_tau
//   damping_time, rotor_inertia           d, I*       torsional_compliance             zeta^
//   coulomb_torque, friction_offset, viscous_positive, viscous_negative                theta^_1 .. theta^_4
//   load_friction_linear, _quadratic      g_1, g_2    adaptation_gain_...              rho_i, rho_zeta
//   velocity_error                        s = phi'_r - phi'
//   N, KE                                 gear_ratio, kinematic error; theta_m = N phi
#pragma once

#include <cmath>

#include "blocks.hpp"
#include "law_math.hpp"

namespace hd {

#define HD_ESTIMATE_BOUNDS(FIELD, estimate, unit, allowed)                 \
    FIELD(estimate##_low, 1, unit, "lower bound of the estimate", allowed) \
    FIELD(estimate##_high, 1, unit, "upper bound of the estimate", allowed)
#define HD_ESTIMATE_START(FIELD, estimate, unit, allowed) \
    FIELD(estimate##_initial, 1, unit, "estimate at the start; a live change moves the estimate there", allowed)

// The adaptation gains of the block have `adaptation_scale` in them, except that of the offset.
#define HD_TORQUE_PARAMS(FIELD)                                                                                      \
    FIELD(law, 0, "-", "adaptive joint torque control, required torque sent to the motor as it is, or another law",  \
          one_of("adaptive direct"))                                                                                 \
    FIELD(compliance_derivative, 0, "-", "derivatives of the wanted torsion",                                        \
          one_of("literal stiffness_only filtered"))                                                                 \
    HD_RATE_SOURCE(FIELD)                                                                                            \
    FIELD(kinematic_feedforward, 0, "-", "take the known kinematic error off the wanted rotor motion", truth())      \
    FIELD(adapt_friction, 0, "-", "friction estimates follow the error", truth())                                    \
    FIELD(adapt_compliance, 0, "-", "the compliance estimate follows the error", truth())                            \
    HD_DERIVATIVE_CUTOFF(FIELD)                                                                                      \
    HD_GEAR_RATIO(FIELD)                                                                                             \
    FIELD(damping_time, 1, "s", "flexspline damping over stiffness", at_least(0.0))                                  \
    HD_ROTOR_INERTIA(FIELD)                                                                                          \
    FIELD(motor_position_gain, 1, "1/s", "motor position error to velocity", above(0.0).times(2.0))                  \
    FIELD(torque_rate_gain, 1, "1/(N m s)", "joint torque error to velocity", above(0.0).times(2.0))                 \
    FIELD(motor_velocity_gain, 1, "N m s", "velocity error to torque", above(0.0).times(2.0))                        \
    FIELD(torque_gain, 1, "-", "joint torque error to torque", at_least(0.0).times(2.0).within(1.0))                 \
    FIELD(load_friction_linear, 1, "1/(N m)", "growth of Coulomb friction with load",                                \
          at_least(0.0).times(4.0).within(2.0))                                                                      \
    FIELD(load_friction_quadratic, 1, "1/(N m)^2", "growth of Coulomb friction with load squared",                   \
          at_least(0.0).times(4.0).within(2.0))                                                                      \
    FIELD(adaptation_gain_coulomb, 1, "N m", "speed of the Coulomb estimate", at_least(0.0).times(10.0))             \
    FIELD(adaptation_gain_offset, 1, "N m", "speed of the offset estimate", at_least(0.0).times(10.0))               \
    FIELD(adaptation_gain_viscous, 1, "N m s^2", "speed of both viscous estimates", at_least(0.0).times(10.0))       \
    FIELD(adaptation_gain_compliance, 1, "1/(N m)^2", "speed of the compliance estimate", at_least(0.0).times(10.0)) \
    HD_ESTIMATE_BOUNDS(FIELD, coulomb_torque, "N m", any().within(0.1))                                              \
    HD_ESTIMATE_START(FIELD, coulomb_torque, "N m", any().within(0.1))                                               \
    HD_ESTIMATE_BOUNDS(FIELD, friction_offset, "N m", any().within(0.1))                                             \
    HD_ESTIMATE_START(FIELD, friction_offset, "N m", any().within(0.1))                                              \
    HD_ESTIMATE_BOUNDS(FIELD, viscous, "N m s", any().times(2.0).within(0.2))                                        \
    HD_ESTIMATE_START(FIELD, viscous_positive, "N m s", any().times(2.0).within(0.2))                                \
    HD_ESTIMATE_START(FIELD, viscous_negative, "N m s", any().times(2.0).within(0.2))                                \
    HD_ESTIMATE_BOUNDS(FIELD, torsional_compliance, "rad/(N m)", above(0.0).times(2.0))                              \
    HD_ESTIMATE_START(FIELD, torsional_compliance, "rad/(N m)", at_least(0.0).times(2.0))                            \
    HD_MOTOR_TORQUE_LIMIT(FIELD)                                                                                     \
    HD_KINEMATIC_ERROR(FIELD)

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

enum Law { kAdaptive = 0, kDirect = 1 };
enum ComplianceDerivative { kLiteral = 0, kStiffnessOnly = 1, kFiltered = 2 };

// The law for one joint and one sample, in the order of docs/equations/adaptive_torque_law.md.
struct TorqueStep {
    const TorqueParams& p;
    const TorqueSample& in;
    const TorqueReference& ref;
    TorqueOutput& out;
    const int j;
    const double pole, T;  // of D; s
    TorqueMemory m;

    double D(double x, double& last, double& rate) const { return differentiate(x, last, rate, pole, T); }

    // First sample: every filter sees a past equal to the present, so all rates start at zero.
    void start() {
        TorqueMemory fresh;
        fresh.coulomb_torque = m.coulomb_torque;
        fresh.friction_offset = m.friction_offset;
        fresh.viscous_positive = m.viscous_positive;
        fresh.viscous_negative = m.viscous_negative;
        fresh.torsional_compliance = m.torsional_compliance;
        m = fresh;
        m.started = 1.0;
        m.joint_velocity_last = in.joint_velocity[j];
        m.joint_torque_last = in.joint_torque[j];
        m.required_torque_last = ref.joint_torque_required[j];
        m.desired_velocity_last = ref.desired_velocity[j];
        m.joint_error_last = ref.desired_position[j] - in.joint_position[j];
        m.motor_error_last = ref.desired_position[j] - in.motor_position[j];
        m.torsional_compliance_last = m.torsional_compliance;
        m.desired_torsion = m.torsional_compliance * ref.joint_torque_required[j];
    }

    // 1. Rates. Both sources are kept running, so a change of `rate_source` finds warm filters.
    void rates() {
        const double qd = ref.desired_position[j], qd_v = ref.desired_velocity[j];
        const double slope = (qd_v - m.desired_velocity_last) / T;
        const double qd_a = 0.5 * (3.0 * slope - m.desired_slope_last);
        m.desired_velocity_last = qd_v;
        m.desired_slope_last = slope;
        double rate_last = m.joint_error_rate;
        const double error_rate = D(qd - in.joint_position[j], m.joint_error_last, m.joint_error_rate);
        const double error_acceleration = D(error_rate, rate_last, m.joint_error_acceleration);
        const double motor_error_rate = D(qd - in.motor_position[j], m.motor_error_last, m.motor_error_rate);
        const double plain_acceleration = D(in.joint_velocity[j], m.joint_velocity_last, m.joint_acceleration);
        const bool plain = p.rate_source[0] == kPlain;
        out.desired_acceleration[j] = qd_a;
        out.joint_velocity[j] = plain ? in.joint_velocity[j] : qd_v - error_rate;
        out.joint_acceleration[j] = plain ? plain_acceleration : qd_a - error_acceleration;
        out.motor_velocity[j] = plain ? in.motor_velocity[j] : qd_v - motor_error_rate;
        out.joint_torque_rate[j] = D(in.joint_torque[j], m.joint_torque_last, m.joint_torque_rate);
        out.required_torque_rate[j] = D(ref.joint_torque_required[j], m.required_torque_last, m.required_torque_rate);
    }

    // 3. y, y', y'' of the wanted torsion, three ways: docs/equations/adaptive_torque_law.md (D2).
    void torsion() {
        const double zeta = m.torsional_compliance, zeta_rate = (zeta - m.torsional_compliance_last) / T;
        const double tau_r = ref.joint_torque_required[j], d = p.damping_time[j];
        const double x = zeta * tau_r, x_rate = zeta * out.required_torque_rate[j] + zeta_rate * tau_r;
        const double old = m.desired_torsion;
        const double step_rate = (x - old) / (d + T);
        const double y = old + T * step_rate;
        double y_last = old;
        const double smooth_rate = D(y, y_last, m.desired_torsion_rate);
        const double smooth_acceleration = D((y - old) / T, m.raw_torsion_rate_last, m.desired_torsion_acceleration);
        m.desired_torsion = y;
        m.torsional_compliance_last = zeta;
        const int variant = static_cast<int>(p.compliance_derivative[0]);
        out.desired_torsion[j] = variant == kStiffnessOnly ? x : y;
        out.desired_torsion_rate[j] = variant == kLiteral ? step_rate : (variant == kFiltered ? smooth_rate : x_rate);
        out.desired_torsion_acceleration[j] =
            variant == kLiteral ? (x_rate - step_rate) / d : (variant == kFiltered ? smooth_acceleration : 0.0);
    }

    // Zhu (7), with the known kinematic error taken off the wanted rotor motion; its rates use the reference velocity.
    void desired_motion() {
        KinematicError ke;
        const double N = p.gear_ratio[j], v = ref.desired_velocity[j], a = out.desired_acceleration[j];
        if (p.kinematic_feedforward[0] != 0.0) {
            ke = kinematic_error(N * in.motor_position[j], &p.kinematic_cosine[kHarmonics * j],
                                 &p.kinematic_sine[kHarmonics * j]);
        }
        out.kinematic_error[j] = ke.value;
        out.kinematic_error_rate[j] = N * ke.slope * v;
        out.kinematic_error_acceleration[j] = N * N * ke.curvature * v * v + N * ke.slope * a;
        out.desired_motor_position[j] = in.joint_position[j] + out.desired_torsion[j] - out.kinematic_error[j];
        out.desired_motor_velocity[j] =
            out.joint_velocity[j] + out.desired_torsion_rate[j] - out.kinematic_error_rate[j];
        out.desired_motor_acceleration[j] =
            out.joint_acceleration[j] + out.desired_torsion_acceleration[j] - out.kinematic_error_acceleration[j];
    }

    // Zhu (8) and its derivative.
    void required_motion() {
        out.motor_position_error[j] = out.desired_motor_position[j] - in.motor_position[j];
        out.motor_velocity_error[j] = out.desired_motor_velocity[j] - out.motor_velocity[j];
        out.joint_torque_error[j] = ref.joint_torque_required[j] - in.joint_torque[j];
        const double torque_error_rate = out.required_torque_rate[j] - out.joint_torque_rate[j];
        out.required_motor_velocity[j] = out.desired_motor_velocity[j] +
                                         p.motor_position_gain[j] * out.motor_position_error[j] +
                                         p.torque_rate_gain[j] * out.joint_torque_error[j];
        out.required_motor_acceleration[j] = out.desired_motor_acceleration[j] +
                                             p.motor_position_gain[j] * out.motor_velocity_error[j] +
                                             p.torque_rate_gain[j] * torque_error_rate;
        out.velocity_error[j] = out.required_motor_velocity[j] - out.motor_velocity[j];
    }

    // 4. Zhu (9), (10): the motor torque as a sum of terms, then the limit of the drive.
    void torque() {
        const double v = out.required_motor_velocity[j], tau = in.joint_torque[j], load = std::fabs(tau);
        out.friction_load_factor[j] =
            1.0 + p.load_friction_linear[j] * load + p.load_friction_quadratic[j] * load * load;
        out.inertia_torque[j] = p.rotor_inertia[j] * out.required_motor_acceleration[j];
        out.coulomb_feedforward[j] = out.friction_load_factor[j] * sign(v) * m.coulomb_torque;
        out.offset_feedforward[j] = m.friction_offset;
        out.viscous_feedforward[j] = v > 0.0 ? v * m.viscous_positive : v * m.viscous_negative;
        out.velocity_feedback[j] = p.motor_velocity_gain[j] * out.velocity_error[j];
        out.joint_torque_feedforward[j] = ref.joint_torque_required[j];
        out.torque_feedback[j] = p.torque_gain[j] * out.joint_torque_error[j];
        const double wanted = out.inertia_torque[j] + out.coulomb_feedforward[j] + out.offset_feedforward[j] +
                              out.viscous_feedforward[j] + out.velocity_feedback[j] + out.joint_torque_feedforward[j] +
                              out.torque_feedback[j];
        out.motor_torque[j] = limited(wanted);
        out.saturation_torque[j] = out.motor_torque[j] - wanted;
    }

    // 5. Zhu (11)-(14): the estimates follow; frozen estimates keep their bits as long as they are inside their bounds.
    void adapt() {
        const double v = out.required_motor_velocity[j], s = out.velocity_error[j];
        out.coulomb_torque_drive[j] = s * out.friction_load_factor[j] * sign(v);
        out.compliance_drive[j] =
            -(1.0 + p.torque_gain[j]) * ref.joint_torque_required[j] *
            (out.motor_velocity_error[j] + p.motor_position_gain[j] * out.motor_position_error[j]);
        const double f = p.adapt_friction[0] != 0.0 ? 1.0 : 0.0, c = p.adapt_compliance[0] != 0.0 ? 1.0 : 0.0;
        m.coulomb_torque = project(m.coulomb_torque, f * out.coulomb_torque_drive[j], p.adaptation_gain_coulomb[j],
                                   p.coulomb_torque_low[j], p.coulomb_torque_high[j], T);
        m.friction_offset = project(m.friction_offset, f * s, p.adaptation_gain_offset[j], p.friction_offset_low[j],
                                    p.friction_offset_high[j], T);
        m.viscous_positive = project(m.viscous_positive, f * s * (v > 0.0 ? v : 0.0), p.adaptation_gain_viscous[j],
                                     p.viscous_low[j], p.viscous_high[j], T);
        m.viscous_negative = project(m.viscous_negative, f * s * (v < 0.0 ? v : 0.0), p.adaptation_gain_viscous[j],
                                     p.viscous_low[j], p.viscous_high[j], T);
        m.torsional_compliance =
            project(m.torsional_compliance, c * out.compliance_drive[j], p.adaptation_gain_compliance[j],
                    p.torsional_compliance_low[j], p.torsional_compliance_high[j], T);
    }

    // Not a number stays what it is: the safety gate must see it.
    double limited(double u) const { return u != u ? u : clip(u, -p.motor_torque_limit[j], p.motor_torque_limit[j]); }

    void adaptive() {
        if (m.started == 0.0) start();
        rates();
        torsion();
        desired_motion();
        required_motion();
        torque();
        show_estimates();
        adapt();
    }

    void show_estimates() const {
        out.coulomb_torque[j] = m.coulomb_torque;
        out.friction_offset[j] = m.friction_offset;
        out.viscous_positive[j] = m.viscous_positive;
        out.viscous_negative[j] = m.viscous_negative;
        out.torsional_compliance[j] = m.torsional_compliance;
    }

    // The required torque goes to the motor as it is; the adaptive filters restart when the law comes back.
    void direct() {
        m.started = 0.0;
        show_estimates();
        out.joint_torque_feedforward[j] = ref.joint_torque_required[j];
        out.motor_torque[j] = limited(ref.joint_torque_required[j]);
        out.saturation_torque[j] = out.motor_torque[j] - ref.joint_torque_required[j];
    }
};

// All joints. A joint whose inputs give no finite torque says so in its output and keeps its memory as it was.
inline void torque_step(const TorqueParams& p, TorqueState& state, const TorqueSample& in, const TorqueReference& ref,
                        TorqueOutput& out, int joints, double dt) {
    const double pole = derivative_pole(p.derivative_cutoff[0], dt);
    for (int j = 0; j < joints; ++j) {
        TorqueStep law{p, in, ref, out, j, pole, dt, load_memory(state, j)};
        if (p.law[0] == kAdaptive) {
            law.adaptive();
        } else {
            law.direct();
        }
        if (std::isfinite(out.motor_torque[j]) && is_finite(law.m)) store_memory(state, law.m, j);
    }
}

}  // namespace hd
