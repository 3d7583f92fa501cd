// Fusion of encoder, resolver and gauge bridge into one state estimate, output side of the gear.
//
//   code                      paper    meaning
//   motor_shaft_position      theta_m  rotor angle, phi = theta_m / N
//   gauge_angle               beta     gauge against the long axis of the wave generator (Hashimoto, Fig. 4)
//   joint_torque              tau      flexspline torque after correction
//   torsional_stiffness       k_f
//
// Gauge: indicated = gain tau + offset + drift (temperature - reference) + sum_{n = 2, 4} a_n cos(n beta) + b_n sin(n
// beta); the law inverts that. The n = 2 term is Hashimoto (9)-(13), n = 4 the part that two bridges at 90 degrees
// leave.
#pragma once

#include <cmath>

#include "blocks.hpp"
#include "law_math.hpp"

namespace hd {

#define HD_FUSION_PARAMS(FIELD)                                                                                        \
    FIELD(joint_position_source, 0, "-", "joint sensor, or motor side above the crossover",                            \
          one_of("resolver complementary"))                                                                            \
    HD_DERIVATIVE_CUTOFF(FIELD)                                                                                        \
    FIELD(crossover, 0, "rad/s", "where the joint sensor hands over to the motor side", above(0.0, 1e4))               \
    HD_GEAR_RATIO(FIELD)                                                                                               \
    HD_TORSIONAL_STIFFNESS(FIELD)                                                                                      \
    FIELD(encoder_period, 1, "rad", "rotor angle at which the encoder wraps; 0: multi-turn", at_least(0.0))            \
    FIELD(resolver_period, 1, "rad", "joint angle at which the resolver wraps; 0: multi-turn", at_least(0.0))          \
    FIELD(encoder_offset, 1, "rad", "rotor angle read at zero")                                                        \
    FIELD(resolver_offset, 1, "rad", "joint angle read at zero")                                                       \
    FIELD(gauge_gain, 1, "-", "indicated torque per true torque", between(0.1, 10.0).times(1.5))                       \
    FIELD(gauge_offset, 1, "N m", "indicated torque at zero torque", any().within(0.1))                                \
    FIELD(gauge_temperature_drift, 1, "N m/K", "change of the offset with temperature", any().times(2.0).within(0.1))  \
    FIELD(gauge_reference_temperature, 1, "degC", "temperature at which gauge_offset holds", between(-100.0, 300.0))   \
    FIELD(gauge_angle_offset, 1, "rad", "gauge angle at zero rotor angle")                                             \
    FIELD(gauge_joint_turns, 1, "-", "turns of the gauge per joint turn: 0 casing fixed, 1 or -1", between(-1.0, 1.0)) \
    FIELD(gauge_cosine_2, 1, "N m", "ripple with cos 2 beta", any().within(0.1))                                       \
    FIELD(gauge_sine_2, 1, "N m", "ripple with sin 2 beta", any().within(0.1))                                         \
    FIELD(gauge_cosine_4, 1, "N m", "ripple with cos 4 beta", any().within(0.1))                                       \
    FIELD(gauge_sine_4, 1, "N m", "ripple with sin 4 beta", any().within(0.1))                                         \
    HD_KINEMATIC_ERROR(FIELD)

#define HD_FUSION_SAMPLE(FIELD)                                                    \
    FIELD(motor_shaft_position, 1, "rad", "rotor angle as read")                   \
    FIELD(joint_position, 1, "rad", "joint angle as read")                         \
    FIELD(gauge_torque, 1, "N m", "torque that the bridge indicates, uncorrected") \
    FIELD(motor_torque, 1, "N m", "motor torque applied, output side")             \
    FIELD(motor_temperature, 1, "degC", "motor temperature; not a number where unknown")

#define HD_FUSION_STATE(FIELD)                                     \
    FIELD(started, 1, "-", "1 after the first usable sample")      \
    FIELD(encoder_last, 1, "rad", "last encoder reading")          \
    FIELD(encoder_turns, 1, "-", "periods added to the encoder")   \
    FIELD(resolver_last, 1, "rad", "last resolver reading")        \
    FIELD(resolver_turns, 1, "-", "periods added to the resolver") \
    FIELD(joint_position_last, 1, "rad", "last joint position")    \
    FIELD(joint_velocity, 1, "rad/s", "D of the joint position")   \
    FIELD(motor_position_last, 1, "rad", "last motor position")    \
    FIELD(motor_velocity, 1, "rad/s", "D of the motor position")   \
    FIELD(crossover_bias, 1, "rad", "slow part of resolver minus motor-side joint position")

#define HD_FUSION_OUTPUT(FIELD)                                                                    \
    FIELD(joint_position, 1, "rad", "joint position q")                                            \
    FIELD(joint_velocity, 1, "rad/s", "D(q)")                                                      \
    FIELD(joint_torque, 1, "N m", "corrected flexspline torque")                                   \
    FIELD(motor_position, 1, "rad", "rotor angle / gear ratio")                                    \
    FIELD(motor_velocity, 1, "rad/s", "D(motor_position)")                                         \
    FIELD(motor_torque, 1, "N m", "motor torque applied, output side")                             \
    FIELD(motor_shaft_position, 1, "rad", "unwrapped rotor angle, offset removed")                 \
    FIELD(resolver_position, 1, "rad", "unwrapped resolver angle, offset removed")                 \
    FIELD(gauge_angle, 1, "rad", "beta")                                                           \
    FIELD(gauge_ripple, 1, "N m", "ripple removed from the indicated torque")                      \
    FIELD(gauge_drift, 1, "N m", "offset and temperature drift removed from the indicated torque") \
    FIELD(kinematic_error, 1, "rad", "KE at the rotor angle")                                      \
    FIELD(torsion, 1, "rad", "joint_torque / torsional_stiffness")                                 \
    FIELD(motor_side_joint_position, 1, "rad", "motor_position + KE - torsion")                    \
    FIELD(crossover_bias, 1, "rad", "slow part of resolver minus motor_side_joint_position")

HD_BLOCK(FusionParams, HD_FUSION_PARAMS)
HD_BLOCK(FusionSample, HD_FUSION_SAMPLE)
HD_BLOCK(FusionState, HD_FUSION_STATE)
HD_BLOCK(FusionOutput, HD_FUSION_OUTPUT)

// Adds whole periods so that the reading moves by less than half a period per sample. Exact: the count of periods is
// kept, not a running sum. A period of 0 leaves the reading alone.
inline double unwrap(double reading, double period, double& last, double& turns) {
    if (!std::isfinite(reading)) return reading;
    if (period > 0.0) turns -= std::floor((reading - last) / period + 0.5);
    last = reading;
    return reading + turns * period;
}

// D of x; an x that gives no finite rate leaves the filter as it was.
inline double differentiate_finite(double x, double& last, double& rate, double pole, double dt) {
    double next_last = last, next_rate = rate;
    const double result = differentiate(x, next_last, next_rate, pole, dt);
    if (!std::isfinite(result)) return result;
    last = next_last;
    rate = next_rate;
    return result;
}

// Indicated torque to joint torque; writes the terms of the correction.
inline void correct_gauge(const FusionParams& p, const FusionSample& in, FusionOutput& out, int j) {
    const double beta =
        out.motor_shaft_position[j] - p.gauge_joint_turns[j] * out.resolver_position[j] + p.gauge_angle_offset[j];
    const double warm = in.motor_temperature[j] - p.gauge_reference_temperature[j];
    const bool drifts = p.gauge_temperature_drift[j] != 0.0 && std::isfinite(warm);
    out.gauge_angle[j] = beta;
    out.gauge_drift[j] = p.gauge_offset[j] + (drifts ? p.gauge_temperature_drift[j] * warm : 0.0);
    const double c2 = std::cos(2.0 * beta), s2 = std::sin(2.0 * beta);
    out.gauge_ripple[j] = p.gauge_cosine_2[j] * c2 + p.gauge_sine_2[j] * s2 +
                          p.gauge_cosine_4[j] * (c2 * c2 - s2 * s2) + p.gauge_sine_4[j] * (2.0 * s2 * c2);
    out.joint_torque[j] = (in.gauge_torque[j] - out.gauge_drift[j] - out.gauge_ripple[j]) / p.gauge_gain[j];
}

// Pole of D; weight of a new resolver sample, 1 - exp(-crossover dt); sample time.
struct FusionFilters {
    double pole, weight, dt;
};

// Joint position from the resolver, or with the motor side above the crossover frequency.
inline void fuse_position(const FusionParams& p, FusionState& m, FusionOutput& out, int j, bool first, double weight) {
    out.kinematic_error[j] = kinematic_error(out.motor_shaft_position[j], &p.kinematic_cosine[kHarmonics * j],
                                             &p.kinematic_sine[kHarmonics * j])
                                 .value;
    out.torsion[j] = out.joint_torque[j] / p.torsional_stiffness[j];
    const double motor_side = out.motor_position[j] + out.kinematic_error[j] - out.torsion[j];
    const double difference = out.resolver_position[j] - motor_side;
    const double bias = first ? difference : m.crossover_bias[j] + weight * (difference - m.crossover_bias[j]);
    if (std::isfinite(bias)) m.crossover_bias[j] = bias;
    out.motor_side_joint_position[j] = motor_side;
    out.crossover_bias[j] = m.crossover_bias[j];
    out.joint_position[j] =
        p.joint_position_source[0] == 0.0 ? out.resolver_position[j] : motor_side + m.crossover_bias[j];
}

// Fills the memory with the first sample: no wraps yet, no rates.
inline void start_fusion(FusionState& m, const FusionSample& in, int j) {
    m.encoder_last[j] = in.motor_shaft_position[j];
    m.resolver_last[j] = in.joint_position[j];
}

// One joint, one sample. A reading that is not finite shows in the output as not finite and does not enter the memory.
inline void fuse_joint(const FusionParams& p, FusionState& m, const FusionSample& in, FusionOutput& out, int j,
                       const FusionFilters& filters) {
    const bool first = m.started[j] == 0.0;
    if (first) start_fusion(m, in, j);
    out.motor_shaft_position[j] =
        unwrap(in.motor_shaft_position[j], p.encoder_period[j], m.encoder_last[j], m.encoder_turns[j]) -
        p.encoder_offset[j];
    out.resolver_position[j] =
        unwrap(in.joint_position[j], p.resolver_period[j], m.resolver_last[j], m.resolver_turns[j]) -
        p.resolver_offset[j];
    out.motor_position[j] = out.motor_shaft_position[j] / p.gear_ratio[j];
    out.motor_torque[j] = in.motor_torque[j];
    correct_gauge(p, in, out, j);
    fuse_position(p, m, out, j, first, filters.weight);
    if (first) {
        m.joint_position_last[j] = out.joint_position[j];
        m.motor_position_last[j] = out.motor_position[j];
        m.started[j] = 1.0;
    }
    const double pole = filters.pole, dt = filters.dt;
    out.joint_velocity[j] =
        differentiate_finite(out.joint_position[j], m.joint_position_last[j], m.joint_velocity[j], pole, dt);
    out.motor_velocity[j] =
        differentiate_finite(out.motor_position[j], m.motor_position_last[j], m.motor_velocity[j], pole, dt);
    if (first && !(std::isfinite(out.joint_velocity[j]) && std::isfinite(out.motor_velocity[j]) &&
                   std::isfinite(out.joint_torque[j]))) {
        m.started[j] = 0.0;
    }
}

inline void fusion_step(const FusionParams& p, FusionState& memory, const FusionSample& in, FusionOutput& out,
                        int joints, double dt) {
    const FusionFilters filters{derivative_pole(p.derivative_cutoff[0], dt), -std::expm1(-p.crossover[0] * dt), dt};
    for (int j = 0; j < joints; ++j) fuse_joint(p, memory, in, out, j, filters);
}

}  // namespace hd
