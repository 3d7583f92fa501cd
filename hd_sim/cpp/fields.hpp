// Every number of the world by name: parameters, state, sensor sample, truth. FIELD(name, per_joint, unit, meaning).
//
// Torques, positions and friction of the motor are referred to the joint side of the gear; zero switches an effect off.
#pragma once

#include "blocks.hpp"
#include "lanes.hpp"

// clang-format off
#define HD_PLANT_PARAMETERS(FIELD) \
    FIELD(link_rotation, 9, "-", "row-major rotation from link frame to parent frame at zero angle") \
    FIELD(link_origin, 3, "m", "origin of the link frame in the parent frame") \
    FIELD(link_mass, 1, "kg", "mass, payload included") \
    FIELD(link_center, 3, "m", "centre of mass in the link frame") \
    FIELD(link_inertia, 9, "kg m^2", "inertia about the centre of mass, row-major") \
    FIELD(gear_ratio, 1, "-", "gear ratio N") \
    FIELD(rotor_inertia, 1, "kg m^2", "rotor inertia times N^2") \
    FIELD(torque_limit, 1, "N m", "largest motor torque times N") \
    FIELD(current_time_constant, 1, "s", "first-order current loop") \
    FIELD(command_delay, 1, "s", "delay of the command that the drive does not report") \
    FIELD(torque_constant_error, 1, "-", "true over reported motor torque, minus 1") \
    FIELD(torque_constant_saturation, 1, "-", "share of torque lost at the torque limit, cubic in the current") \
    FIELD(cogging_order, 2, "1/rev", "lines of motor cogging per rotor turn") \
    FIELD(cogging_amplitude, 2, "N m", "amplitude of each line") \
    FIELD(cogging_phase, 2, "rad", "phase of each line") \
    FIELD(stiffness_linear, 1, "N m/rad", "m1") \
    FIELD(stiffness_cubic, 1, "N m/rad^3", "m2") \
    FIELD(stiffness_quintic, 1, "N m/rad^5", "m3") \
    FIELD(torsional_damping, 1, "N m s/rad", "k_d") \
    FIELD(hysteresis_stiffness, 1, "N m/rad", "A") \
    FIELD(hysteresis_rate, 1, "1/rad", "alpha") \
    FIELD(kinematic_cosine, 4, "rad", "a_1..a_4, per rotor turn, at the output") \
    FIELD(kinematic_sine, 4, "rad", "b_1..b_4") \
    FIELD(windup_depth, 1, "rad", "lost motion of the soft wind-up zone") \
    FIELD(windup_width, 1, "rad", "torsion over which the wind-up zone closes") \
    FIELD(backlash_half_gap, 1, "rad", "half the free play at the output") \
    FIELD(slip_stiffness, 4, "N m/rad", "elements of the Maxwell-slip hysteresis") \
    FIELD(slip_yield, 4, "N m", "yield torque of each element") \
    FIELD(kinematic_load_slope, 1, "1/(N m)", "relative growth of the kinematic error with torque") \
    FIELD(kinematic_angle_modulation, 1, "-", "relative change of the kinematic error over a joint turn") \
    FIELD(tooth_defect_height, 1, "rad", "local transmission error") \
    FIELD(tooth_defect_position, 1, "rad", "where it lies, rotor angle at the output") \
    FIELD(tooth_defect_width, 1, "rad", "its standard deviation") \
    FIELD(friction_law, 1, "-", "0 set-valued Coulomb, 1 bristle, 2 Maxwell-slip") \
    FIELD(coulomb_torque, 1, "N m", "k_c") \
    FIELD(friction_offset, 1, "N m", "c") \
    FIELD(viscous_positive, 1, "N m s/rad", "k_vp") \
    FIELD(viscous_negative, 1, "N m s/rad", "k_vn") \
    FIELD(load_friction_linear, 1, "1/(N m)", "g1") \
    FIELD(load_friction_quadratic, 1, "1/(N m)^2", "g2") \
    FIELD(stribeck_ratio, 1, "-", "static over Coulomb friction") \
    FIELD(stribeck_velocity, 1, "rad/s", "v_s") \
    FIELD(bristle_stiffness, 1, "N m/rad", "sigma_0") \
    FIELD(bristle_damping, 1, "N m s/rad", "sigma_1") \
    FIELD(friction_slip_share, 4, "-", "share of the Coulomb torque in each Maxwell-slip element") \
    FIELD(friction_slip_distance, 4, "rad", "travel at which each element slips") \
    FIELD(quadratic_drag, 1, "N m s^2/rad^2", "torque proportional to v|v|") \
    FIELD(coulomb_temperature_slope, 1, "1/K", "relative change of Coulomb friction per kelvin") \
    FIELD(viscous_temperature_slope, 1, "1/K", "relative change of viscous friction per kelvin") \
    FIELD(reference_temperature, 1, "degC", "temperature at which friction has its stated values") \
    FIELD(friction_angle_modulation, 1, "-", "relative change of Coulomb friction over a joint turn") \
    FIELD(friction_angle_phase, 1, "rad", "its phase") \
    FIELD(friction_step_time, 1, "s", "when Coulomb friction steps") \
    FIELD(friction_step_ratio, 1, "-", "relative size of the step") \
    FIELD(link_coulomb, 1, "N m", "friction on the link side of the torque sensor") \
    FIELD(link_viscous, 1, "N m s/rad", "viscous friction there") \
    FIELD(link_bristle_stiffness, 1, "N m/rad", "presliding stiffness there") \
    FIELD(link_bristle_damping, 1, "N m s/rad", "presliding damping there") \
    FIELD(cable_torque, 1, "N m", "torque of a cable, sine over joint angle") \
    FIELD(cable_order, 1, "1/rev", "its periods per joint turn") \
    FIELD(cable_phase, 1, "rad", "its phase") \
    FIELD(pulse_torque, 1, "N m", "contact pulses on the link, half sines") \
    FIELD(pulse_period, 1, "s", "time between pulses") \
    FIELD(pulse_duration, 1, "s", "length of one pulse") \
    FIELD(resonance_inertia, 1, "kg m^2", "share of the link inertia that hangs on a spring") \
    FIELD(resonance_frequency, 1, "Hz", "its natural frequency") \
    FIELD(resonance_damping, 1, "-", "its damping ratio") \
    FIELD(encoder_counts, 1, "1/rev", "motor encoder counts per rotor turn, 0: exact") \
    FIELD(resolver_counts, 1, "1/rev", "joint resolver counts per joint turn, 0: exact") \
    FIELD(resolver_noise, 1, "rad", "standard deviation before quantisation") \
    FIELD(eccentricity_cosine, 2, "rad", "joint sensor error, 1 and 2 per joint turn") \
    FIELD(eccentricity_sine, 2, "rad", "joint sensor error, 1 and 2 per joint turn") \
    FIELD(sampling_jitter, 1, "s", "standard deviation of the sampling instant of both angles") \
    FIELD(gauge_gain_error, 1, "-", "indicated over true torque, minus 1") \
    FIELD(gauge_offset, 1, "N m", "indicated torque without load") \
    FIELD(gauge_noise, 1, "N m", "standard deviation per sample") \
    FIELD(gauge_time_constant, 1, "s", "first-order low-pass of the bridge amplifier") \
    FIELD(gauge_ripple_amplitude, 1, "N m", "misalignment ripple at twice the gauge angle") \
    FIELD(gauge_ripple_phase, 1, "rad", "its phase") \
    FIELD(gauge_fourth_amplitude, 1, "N m", "ripple at four times the gauge angle") \
    FIELD(gauge_joint_turn, 1, "-", "-1, 0 or 1: how the gauge angle follows the joint") \
    FIELD(gauge_mounting_angle, 1, "rad", "gauge angle at zero") \
    FIELD(gauge_gain_temperature, 1, "1/K", "gain change per kelvin") \
    FIELD(gauge_offset_temperature, 1, "N m/K", "zero shift per kelvin") \
    FIELD(gauge_offset_drift, 1, "N m/s", "zero shift with time") \
    FIELD(ambient_temperature, 1, "degC", "temperature without losses") \
    FIELD(thermal_time_constant, 1, "s", "of motor and gear, one lump") \
    FIELD(copper_heating, 1, "K/(N m)^2", "steady rise per squared motor torque") \
    FIELD(friction_heating, 1, "K/W", "steady rise per watt of friction") \
    FIELD(brake_torque, 1, "N m", "holding torque of the closed brake, on the rotor") \
    FIELD(brake_closing_time, 1, "s", "from request to hold")

constexpr int DELAY_TICKS = 32;  // ring of past commands

#define HD_PLANT_STATE(FIELD) \
    FIELD(motor_position, 1, "rad", "phi") \
    FIELD(motor_velocity, 1, "rad/s", "v") \
    FIELD(joint_position, 1, "rad", "q") \
    FIELD(joint_velocity, 1, "rad/s", "w") \
    FIELD(torsion, 1, "rad", "torsion at the last mid-step") \
    FIELD(hysteresis_torque, 1, "N m", "hysteresis torque at the last mid-step") \
    FIELD(motor_acceleration, 1, "rad/s^2", "last rotor acceleration") \
    FIELD(joint_acceleration, 1, "rad/s^2", "last link acceleration") \
    FIELD(joint_torque, 1, "N m", "flexspline torque, mean of the last substep") \
    FIELD(friction_torque, 1, "N m", "motor friction and brake, mean of the last substep") \
    FIELD(current_torque, 1, "N m", "motor torque after the current loop") \
    FIELD(gauge_filtered, 1, "N m", "torque behind the bridge amplifier's low-pass") \
    FIELD(temperature, 1, "degC", "motor and gear") \
    FIELD(slip_torque, 4, "N m", "Maxwell-slip hysteresis elements") \
    FIELD(friction_memory, 4, "rad or N m", "bristle deflection, or Maxwell-slip friction elements") \
    FIELD(link_bristle, 1, "rad", "bristle of the link friction") \
    FIELD(resonance_position, 1, "rad", "angle of the hanging inertia") \
    FIELD(resonance_velocity, 1, "rad/s", "its rate") \
    FIELD(brake_request, 1, "-", "1 if the brake is requested") \
    FIELD(brake_age, 1, "s", "time since the request") \
    FIELD(external_joint_torque, 1, "N m", "torque from outside on the link") \
    FIELD(external_motor_torque, 1, "N m", "torque from outside on the rotor") \
    FIELD(commands, 32, "N m", "ring of limited commands") \
    FIELD(motor_work, 1, "J", "work of the motor torque") \
    FIELD(friction_work, 1, "J", "work lost in motor friction") \
    FIELD(damping_work, 1, "J", "work lost in torsional damping") \
    FIELD(hysteresis_work, 1, "J", "work done on the hysteresis") \
    FIELD(tick, 0, "-", "ticks since the start") \
    FIELD(extra_link_solves, 0, "-", "repeated link solves since the start")

#define HD_PLANT_SAMPLE(FIELD) \
    FIELD(motor_shaft_position, 1, "rad", "quantised multi-turn rotor angle") \
    FIELD(joint_position, 1, "rad", "quantised joint angle") \
    FIELD(gauge_torque, 1, "N m", "torque that the bridge indicates") \
    FIELD(motor_torque_applied, 1, "N m", "motor torque set-point in force, after limit and reported delay") \
    FIELD(motor_temperature, 1, "degC", "motor and gear")

#define HD_PLANT_TRUTH(FIELD) \
    FIELD(motor_position, 1, "rad", "phi") \
    FIELD(motor_velocity, 1, "rad/s", "rate of phi") \
    FIELD(joint_position, 1, "rad", "q") \
    FIELD(joint_velocity, 1, "rad/s", "rate of q") \
    FIELD(joint_acceleration, 1, "rad/s^2", "of the last substep") \
    FIELD(joint_torque, 1, "N m", "flexspline torque at the end of the step") \
    FIELD(motor_torque, 1, "N m", "motor torque that acts on the rotor") \
    FIELD(friction_torque, 1, "N m", "motor friction and brake, mean of the last substep; at rest what balances the rotor") \
    FIELD(kinematic_error, 1, "rad", "harmonics only") \
    FIELD(torsion, 1, "rad", "at the end of the step") \
    FIELD(hysteresis_torque, 1, "N m", "at the end of the step") \
    FIELD(temperature, 1, "degC", "motor and gear")
// clang-format on

namespace hd_sim {

HD_BLOCK(PlantSample, HD_PLANT_SAMPLE)
HD_BLOCK(PlantTruth, HD_PLANT_TRUTH)

// Fields in the kernel's own layout: one padded row of joints per number.
#define HD_ROWS(name, per_joint, unit, meaning) \
    alignas(P == 1 ? 8 : 16) double name[per_joint == 0 ? 1 : per_joint][P] = {};

template <int P>
struct Parameters {
    HD_PLANT_PARAMETERS(HD_ROWS)
    static const std::vector<hd::Field>& fields() {
        static const std::vector<hd::Field> list{HD_PLANT_PARAMETERS(HD_FIELD_ENTRY)};
        return list;
    }
};

template <int P>
struct State {
    HD_PLANT_STATE(HD_ROWS)
    static const std::vector<hd::Field>& fields() {
        static const std::vector<hd::Field> list{HD_PLANT_STATE(HD_FIELD_ENTRY)};
        return list;
    }
};

// Copies between a flat block (joint-major) and padded rows (number-major), field by field in declaration order.
template <int P, class Rows, class Copy>
void each_number(Rows& rows, int joints, Copy copy) {
    auto* row = reinterpret_cast<std::conditional_t<std::is_const_v<Rows>, const double, double>*>(&rows);
    std::size_t flat = 0;
    for (const hd::Field& field : Rows::fields()) {
        const int numbers = field.per_joint == 0 ? 1 : field.per_joint, owners = field.per_joint == 0 ? 1 : joints;
        for (int j = 0; j < owners; ++j) {
            for (int i = 0; i < numbers; ++i) copy(row[i * P + j], flat++);
        }
        row += numbers * P;
    }
}

template <int P, class Rows>
void read_block(Rows& rows, const double* flat, int joints) {
    each_number<P>(rows, joints, [flat](double& number, std::size_t i) { number = flat[i]; });
}

template <int P, class Rows>
void write_block(const Rows& rows, double* flat, int joints) {
    each_number<P>(rows, joints, [flat](const double& number, std::size_t i) { flat[i] = number; });
}

}  // namespace hd_sim
