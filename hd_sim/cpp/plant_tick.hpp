// Plant<N>: what happens once per tick or less: set-up, start, slow states, sample, truth.
#pragma once

#include <algorithm>

namespace hd_sim {

template <int N>
void Plant<N>::derive(int j) {
    const auto blend = [&](double time_constant) {
        return time_constant > 0.0 ? -std::expm1(-o_.dt / time_constant) : 1.0;
    };
    const double rate = p_.hysteresis_rate[0][j], fast = p_.stribeck_velocity[0][j];
    d_.current_blend[j] = blend(p_.current_time_constant[0][j]);
    d_.gauge_blend[j] = blend(p_.gauge_time_constant[0][j]);
    d_.hysteresis_limit[j] = rate > 0.0 ? p_.hysteresis_stiffness[0][j] / rate : 0.0;
    d_.stribeck_excess[j] = p_.stribeck_ratio[0][j] - 1.0;
    d_.stribeck_inverse[j] = fast > 0.0 ? 1.0 / fast : 0.0;
    d_.stribeck = d_.stribeck || (j < N && d_.stribeck_excess[j] != 0.0);
}

template <int N>
void Plant<N>::build_arm() {
    for (int j = 0; j < N; ++j) {
        const auto r = [&](int i) { return p_.link_rotation[i][j]; };
        const auto i = [&](int k) { return p_.link_inertia[k][j]; };
        const double m = p_.link_mass[0][j];
        const Vec3 c{p_.link_center[0][j], p_.link_center[1][j], p_.link_center[2][j]};
        Link& link = arm_.links[j];
        link.rotation = {{r(0), r(3), r(6)}, {r(1), r(4), r(7)}, {r(2), r(5), r(8)}};
        link.origin = {p_.link_origin[0][j], p_.link_origin[1][j], p_.link_origin[2][j]};
        link.mass = m;
        link.moment = m * c;
        link.about_origin = {i(0) + m * (c.y * c.y + c.z * c.z),
                             i(4) + m * (c.x * c.x + c.z * c.z),
                             i(8) + m * (c.x * c.x + c.y * c.y),
                             i(1) - m * c.x * c.y,
                             i(2) - m * c.x * c.z,
                             i(5) - m * c.y * c.z};
    }
    arm_.base_acceleration = {0.0, 0.0, 9.81};
}

// Commands, temperature and brake as they act over this tick.
template <int N>
void Plant<N>::begin_tick() {
    const int now = slot(o_.reported_delay);
    for (int j = 0; j < N; ++j) {
        const double warm = s_.temperature[0][j] - p_.reference_temperature[0][j];
        double dry = std::max(0.05, 1.0 + p_.coulomb_temperature_slope[0][j] * warm);
        const double wet = std::max(0.05, 1.0 + p_.viscous_temperature_slope[0][j] * warm);
        if (p_.friction_step_ratio[0][j] != 0.0 && time() >= p_.friction_step_time[0][j]) {
            dry *= 1.0 + p_.friction_step_ratio[0][j];
        }
        t_.command[j] = s_.commands[now][j];
        t_.torque_gain[j] = 1.0 + p_.torque_constant_error[0][j];
        t_.coulomb[j] = dry * p_.coulomb_torque[0][j];
        t_.viscous_positive[j] = wet * p_.viscous_positive[0][j];
        t_.viscous_negative[j] = wet * p_.viscous_negative[0][j];
        const bool closed = s_.brake_request[0][j] != 0.0 && s_.brake_age[0][j] >= p_.brake_closing_time[0][j] - 1e-9;
        t_.brake[j] = closed ? p_.brake_torque[0][j] : 0.0;
    }
}

template <int N>
void Plant<N>::end_tick() {
    const double period = o_.dt * o_.substeps;
    const int old = slot(0);
    s_.tick[0][0] += 1.0;
    const int next = slot(0);
    for (int j = 0; j < N; ++j) {
        s_.commands[next][j] = s_.commands[old][j];
        if (s_.brake_request[0][j] != 0.0) s_.brake_age[0][j] += period;
        const double u = s_.current_torque[0][j];
        const double lost = std::fabs(s_.friction_torque[0][j] * s_.motor_velocity[0][j]);
        const double rise = p_.copper_heating[0][j] * u * u + p_.friction_heating[0][j] * lost;
        const double slow = p_.thermal_time_constant[0][j];
        if (slow > 0.0)
            s_.temperature[0][j] += (p_.ambient_temperature[0][j] + rise - s_.temperature[0][j]) * (period / slow);
    }
}

// Flexspline torque at the end of the step from the constitutive law; the hysteresis is advanced but not stored.
template <int N>
Transmitted Plant<N>::at_end(int j) const {
    const double phi = s_.motor_position[0][j], v = s_.motor_velocity[0][j], ratio = p_.gear_ratio[0][j];
    Work<P> at;
    at.kinematic[j] = at.kinematic_slope[j] = 0.0;
    for (int n = 1; n <= 4; ++n) {
        double sine, cosine;
        sin_cos(n * (ratio * phi), sine, cosine);
        const double a = p_.kinematic_cosine[n - 1][j], b = p_.kinematic_sine[n - 1][j];
        at.kinematic[j] += a * cosine + b * sine;
        at.kinematic_slope[j] += ratio * n * (b * cosine - a * sine);
    }
    const double harmonics = at.kinematic[j];
    at.phi[j] = phi;
    at.q[j] = s_.joint_position[0][j];
    if (effects_.kinematics[j]) shape_kinematics(p_, s_, at, j);
    const double delta = phi + at.kinematic[j] - at.q[j], step = delta - s_.torsion[0][j];
    const double limit = step < 0.0 ? -d_.hysteresis_limit[j] : d_.hysteresis_limit[j];
    const double h =
        limit + (s_.hysteresis_torque[0][j] - limit) * exp_negative(-p_.hysteresis_rate[0][j] * std::fabs(step));
    double next[4];
    const double slip = slip_elements(p_, s_, j, step, next).torque;
    const double Y = 1.0 + at.kinematic_slope[j], rate = Y * v - s_.joint_velocity[0][j];
    const double torque = elastic(p_, j, delta).torque + h + slip + p_.torsional_damping[0][j] * rate;
    return {torque, delta, h + slip, harmonics, Y};
}

template <int N>
void Plant<N>::sample(double* flat) {
    double torque[N];
    for (int j = 0; j < N; ++j) torque[j] = at_end(j).torque;
    PlantSample out(flat, N);
    read_sensors<N>(p_, s_, o_.keys, torque, slot(o_.reported_delay), time(), out);
}

template <int N>
void Plant<N>::truth(double* flat) {
    PlantTruth out(flat, N);
    begin_tick();
    for (int j = 0; j < N; ++j) {
        out.motor_position[j] = s_.motor_position[0][j];
        out.motor_velocity[j] = s_.motor_velocity[0][j];
        out.joint_position[j] = s_.joint_position[0][j];
        out.joint_velocity[j] = s_.joint_velocity[0][j];
        out.joint_acceleration[j] = s_.joint_acceleration[0][j];
        const Transmitted end = at_end(j);
        out.joint_torque[j] = end.torque;
        out.torsion[j] = end.torsion;
        out.hysteresis_torque[j] = end.hysteresis;
        out.kinematic_error[j] = end.kinematic;
        out.motor_torque[j] = t_.torque_gain[j] * s_.current_torque[0][j];
        out.friction_torque[j] = s_.friction_torque[0][j];
        out.temperature[j] = s_.temperature[0][j];
    }
}

// At rest at `pose` (of the links, or of the motors if `motor_side`), carrying `torque`, hysteresis relaxed.
template <int N>
void Plant<N>::start(const double* pose, const double* torque, bool motor_side) {
    s_ = State<P>{};
    for (int j = 0; j < N; ++j) {
        double low = -1.0, high = 1.0;
        for (int i = 0; i < 200; ++i) {
            const double middle = 0.5 * (low + high);
            (elastic(p_, j, middle).torque < torque[j] ? low : high) = middle;
        }
        const double delta = std::fabs(torque[j]) > 0.0 ? 0.5 * (low + high) : 0.0;
        double phi = motor_side ? pose[j] : pose[j] + delta, Y = 1.0;
        s_.joint_position[0][j] = pose[j];
        s_.joint_torque[0][j] = s_.gauge_filtered[0][j] = torque[j];
        for (int i = 0; i < 60; ++i) {  // phi + KE(N phi) = q + delta, damped fixed point
            s_.motor_position[0][j] = phi;
            const Transmitted now = at_end(j);
            Y = now.slope;
            if (motor_side) {
                s_.joint_position[0][j] += now.torsion - delta;
            } else {
                phi += 0.5 * (delta - now.torsion);
            }
        }
        s_.torsion[0][j] = delta;
        s_.current_torque[0][j] = Y * torque[j] + p_.friction_offset[0][j];
        s_.resonance_position[0][j] = s_.joint_position[0][j];
        s_.temperature[0][j] = p_.ambient_temperature[0][j];
        for (int i = 0; i < DELAY_TICKS; ++i) s_.commands[i][j] = s_.current_torque[0][j];
    }
}

template <int N>
void Plant<N>::accelerate(const double* q, const double* w, const double* torque, const double* armature,
                          double* acceleration, double* inertia, double* bias) {
    double sine[N], cosine[N];
    for (int j = 0; j < N; ++j) sin_cos(q[j], sine[j], cosine[j]);
    Arm<N> arm = arm_;
    arm.update(sine, cosine, w);
    arm.solve(torque, armature, acceleration);
    for (int i = 0; i < N; ++i) {
        bias[i] = arm.bias[i];
        for (int k = 0; k < N; ++k) inertia[i * N + k] = i >= k ? arm.inertia[i][k] : arm.inertia[k][i];
    }
}

}  // namespace hd_sim
