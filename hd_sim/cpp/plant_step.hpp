// Plant<N>: one substep. The numbers of the steps are those of docs/world.md.
#pragma once

namespace hd_sim {

template <int N>
void Plant<N>::substep(int index) {
    midpoint<N>(p_, s_, d_, k_);
    if (effects_.any) add_effects_before_friction();
    transmission<N>(p_, s_, d_, k_);
    if (effects_.any) {
        for (int j = 0; j < N; ++j) {
            if (effects_.spring[j]) stiffen(p_, s_, d_, k_, j);
        }
        delayed_commands(index);
    }
    friction<N>(p_, s_, d_, t_, k_);
    rotor_balance<N>(p_, s_, d_, t_, k_);
    for (int j = 0; j < N; ++j) k_.extra_torque[j] = s_.external_joint_torque[0][j];
    if (effects_.any) add_effects_after_balance(time() + (index + 0.5) * o_.dt);
    arm_.update(k_.sin_q, k_.cos_q, k_.w);
    solve_links();
    finish();
}

template <int N>
void Plant<N>::add_effects_before_friction() {
    for (int j = 0; j < N; ++j) {
        if (effects_.kinematics[j]) shape_kinematics(p_, s_, k_, j);
    }
}

template <int N>
void Plant<N>::add_effects_after_balance(double time) {
    for (int j = 0; j < N; ++j) {
        if (effects_.friction[j]) change_friction(p_, s_, d_, t_, k_, j);
        if (effects_.motor[j]) load_motor(p_, s_, d_, k_, j);
        if (effects_.link[j]) load_link(p_, s_, d_, k_, j, time);
    }
}

// A delay that the drive does not report may end inside a tick.
template <int N>
void Plant<N>::delayed_commands(int index) {
    for (int j = 0; j < N; ++j) {
        if (!effects_.delay[j]) continue;
        const int steps = static_cast<int>(p_.command_delay[0][j] / o_.dt + 0.5) - index;
        const int ticks = steps > 0 ? (steps + o_.substeps - 1) / o_.substeps : 0;
        t_.command[j] = s_.commands[slot(o_.reported_delay + ticks)][j];
    }
}

// Numerator b of the end velocities with the present link acceleration, and the friction modes that follow.
template <int N>
void Plant<N>::classify_all(Mode* modes) {
    for (int j = 0; j < N; ++j) {
        const double b = k_.momentum[j] + k_.pull[j] * k_.acceleration[j];
        k_.numerator[j] = b;
        modes[j] = o_.first_order ? classify_first_order(b, k_.grip[j])
                                  : classify(b, s_.motor_velocity[0][j], k_.inertia[j], k_.grip[j], k_.e_positive[j],
                                             k_.e_negative[j]);
    }
}

// Step 6: torque and apparent armature of each joint for the accepted modes.
template <int N>
void Plant<N>::adopt(const Mode* modes) {
    for (int j = 0; j < N; ++j) {
        const Mode mode = modes_[j] = modes[j];
        const double v = s_.motor_velocity[0][j], Y = k_.slope[j], c_t = k_.stiffening[j];
        double torque = k_.torque_0[j] - c_t * Y * v, armature = o_.dt * c_t;
        if (mode.kind != 0) {
            const Slope line =
                o_.first_order ? slope_first_order(mode, k_.inertia[j], k_.grip[j], k_.e_positive[j], k_.e_negative[j])
                               : slope_of(mode, v, k_.inertia[j], k_.grip[j], k_.e_positive[j], k_.e_negative[j]);
            k_.shift[j] = line.shift;
            k_.inverse[j] = 1.0 / line.divisor;
            torque += c_t * Y * ((k_.momentum[j] + line.shift) * k_.inverse[j]);
            armature *= 1.0 - o_.dt * Y * Y * c_t * k_.inverse[j];
        }
        k_.link_torque[j] = torque + k_.extra_torque[j];
        k_.armature[j] = armature - p_.resonance_inertia[0][j];
    }
}

// Steps 6 and 7: solve the links, confirm the modes, repeat at most three times.
template <int N>
void Plant<N>::solve_links() {
    Mode found[N];
    for (int j = 0; j < N; ++j) k_.acceleration[j] = s_.joint_acceleration[0][j];
    classify_all(found);
    for (int solves = 1;; ++solves) {
        adopt(found);
        arm_.solve(k_.link_torque, k_.armature, k_.acceleration);
        classify_all(found);
        if (solves == 4) return;
        bool changed = false;
        for (int j = 0; j < N; ++j) {
            const bool moved = found[j].kind * found[j].kind == 4 && std::fabs(found[j].cross - modes_[j].cross) > 0.02;
            changed = changed || found[j].kind != modes_[j].kind || moved;
        }
        if (!changed) return;
        s_.extra_link_solves[0][0] += 1.0;
    }
}

// Step 8: advance rotor and link.
template <int N>
void Plant<N>::finish() {
    for (int j = 0; j < N; ++j) {
        const Mode mode = modes_[j];
        const double v = s_.motor_velocity[0][j], w = s_.joint_velocity[0][j];
        const double v_end = mode.kind == 0 ? 0.0 : (k_.numerator[j] + k_.shift[j]) * k_.inverse[j];
        const double w_end = w + o_.dt * k_.acceleration[j];
        const double torque = k_.torque_0[j] + k_.stiffening[j] * (k_.slope[j] * (v_end - v) - (w_end - w));
        s_.friction_torque[0][j] =
            k_.drive_torque[j] - k_.slope[j] * torque - p_.rotor_inertia[0][j] * ((v_end - v) * d_.rate);
        double travel = d_.half * (v + v_end), v_a = 0.0;
        if (mode.kind == 0) {
            travel = d_.half * mode.cross * v;
        } else if (mode.kind == 2 || mode.kind == -2) {
            const double rest = 1.0 - mode.cross;
            travel = d_.half * (mode.cross * v + rest * v_end);
            v_a = rest > 1e-3 ? v_end / (rest * o_.dt) : 0.0;
        } else if (v != 0.0) {
            v_a = (v_end - v) / o_.dt;
        }
        if (o_.accounts) account(j, v, v_end, w, w_end);
        s_.joint_position[0][j] += d_.half * (w + w_end);
        s_.joint_velocity[0][j] = w_end;
        s_.joint_acceleration[0][j] = k_.acceleration[j];
        s_.motor_position[0][j] += travel;
        s_.motor_velocity[0][j] = v_end;
        s_.motor_acceleration[0][j] = v_a;
        s_.torsion[0][j] = k_.torsion[j];
        s_.hysteresis_torque[0][j] = k_.hysteresis[j];
        s_.joint_torque[0][j] = torque;
        s_.gauge_filtered[0][j] += (torque - s_.gauge_filtered[0][j]) * d_.gauge_blend[j];
    }
}

// Work of one substep; velocity is linear in time on each side of a zero crossing. Basic drive only.
template <int N>
void Plant<N>::account(int j, double v, double v_end, double w, double w_end) {
    const Mode mode = modes_[j];
    const bool split = mode.kind == 2 || mode.kind == -2 || mode.kind == 0;
    const double first = split ? mode.cross : 1.0, last = split && mode.kind != 0 ? 1.0 - mode.cross : 0.0;
    const double before = split ? 0.0 : v_end;  // end of the first part
    const double path = d_.half * first * (v + before), back = d_.half * last * v_end;
    const double grip = k_.grip[j] / o_.dt, third = o_.dt / 3.0;
    const auto viscous = [&](double speed) { return (speed > 0.0 ? k_.e_positive[j] : k_.e_negative[j]) / d_.half; };
    const double drag = viscous(v != 0.0 ? v : v_end) * (v * v + v * before + before * before) * first +
                        viscous(v_end) * v_end * v_end * last;
    const double rate = 0.5 * (k_.slope[j] * (v + v_end) - (w + w_end));
    const double D = k_.hysteresis_step[j], x = p_.hysteresis_rate[0][j] * std::fabs(D);
    const double limit = D < 0.0 ? -d_.hysteresis_limit[j] : d_.hysteresis_limit[j];
    const double mean = x > 0.0 ? -std::expm1(-x) / x : 1.0;
    s_.motor_work[0][j] += k_.drive_torque[j] * (path + back);
    s_.friction_work[0][j] +=
        grip * (std::fabs(path) + std::fabs(back)) + p_.friction_offset[0][j] * (path + back) + drag * third;
    s_.damping_work[0][j] += p_.torsional_damping[0][j] * rate * rate * o_.dt;
    s_.hysteresis_work[0][j] += limit * D + (s_.hysteresis_torque[0][j] - limit) * D * mean;
}

}  // namespace hd_sim
