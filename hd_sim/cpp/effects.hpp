// What the world has beyond the basic drive: computed per joint and only where switched on.
//
// Springs add to the torque and its slope, loads add to the rotor or link balance, friction laws replace the set-valued
// magnitude by a torque with memory. The signs are those of drive.hpp. A zero parameter switches an effect off.
#pragma once

#include "drive.hpp"

namespace hd_sim {

constexpr double TURN = 6.283185307179586;

template <int P>
struct Effects {
    bool spring[P] = {}, kinematics[P] = {}, motor[P] = {}, friction[P] = {}, link[P] = {}, delay[P] = {};
    bool any = false;

    void find(const Parameters<P>& p, int joints, double hidden_delay_floor) {
        any = false;
        for (int j = 0; j < joints; ++j) {
            spring[j] =
                p.windup_depth[0][j] != 0.0 || p.backlash_half_gap[0][j] != 0.0 || p.slip_stiffness[0][j] != 0.0;
            kinematics[j] = p.kinematic_load_slope[0][j] != 0.0 || p.kinematic_angle_modulation[0][j] != 0.0 ||
                            p.tooth_defect_height[0][j] != 0.0;
            motor[j] = p.cogging_amplitude[0][j] != 0.0 || p.cogging_amplitude[1][j] != 0.0 ||
                       p.torque_constant_saturation[0][j] != 0.0;
            friction[j] = p.friction_law[0][j] != 0.0 || p.friction_angle_modulation[0][j] != 0.0;
            link[j] = p.link_coulomb[0][j] != 0.0 || p.link_viscous[0][j] != 0.0 || p.cable_torque[0][j] != 0.0 ||
                      p.pulse_torque[0][j] != 0.0 || p.resonance_inertia[0][j] != 0.0;
            delay[j] = p.command_delay[0][j] > hidden_delay_floor;
            any = any || spring[j] || kinematics[j] || motor[j] || friction[j] || link[j] || delay[j];
        }
    }
};

struct Spring {
    double torque, slope;
};

inline double tanh_of(double x) {
    const double e = exp_negative(-2.0 * std::fabs(x));
    const double t = (1.0 - e) / (1.0 + e);
    return x < 0.0 ? -t : t;
}

// Elastic torque at torsion delta: polynomial spring behind a backlash gap and a soft wind-up zone (no hysteresis).
template <int P>
Spring elastic(const Parameters<P>& p, int j, double delta) {
    const double gap = p.backlash_half_gap[0][j], depth = p.windup_depth[0][j], width = p.windup_width[0][j];
    double x = delta > gap ? delta - gap : (delta < -gap ? delta + gap : 0.0),
           slope = x != 0.0 || gap == 0.0 ? 1.0 : 0.0;
    if (depth != 0.0) {  // x - depth tanh(x / width): soft while |x| < width, then stiff with lost motion `depth`
        const double t = tanh_of(x / width);
        slope *= 1.0 - depth / width * (1.0 - t * t);
        x -= depth * t;
    }
    const double m1 = p.stiffness_linear[0][j], m2 = p.stiffness_cubic[0][j], m3 = p.stiffness_quintic[0][j], y = x * x;
    return {x * (m1 + y * (m2 + y * m3)), slope * (m1 + y * (3.0 * m2 + y * (5.0 * m3)))};
}

// Maxwell-slip hysteresis after a torsion step: torque and slope; the four torques go to `next`.
template <int P>
Spring slip_elements(const Parameters<P>& p, const State<P>& s, int j, double step, double* next) {
    Spring sum{0.0, 0.0};
    for (int i = 0; i < 4; ++i) {
        const double stiffness = p.slip_stiffness[i][j], yield = p.slip_yield[i][j];
        const double trial = s.slip_torque[i][j] + stiffness * step;
        next[i] = trial > yield ? yield : (trial < -yield ? -yield : trial);
        sum = {sum.torque + next[i], sum.slope + (next[i] == trial ? stiffness : 0.0)};
    }
    return sum;
}

template <int P>
void shape_kinematics(const Parameters<P>& p, const State<P>& s, Work<P>& k, int j) {
    const double turn = k.q[j];
    double sine, cosine;
    sin_cos(turn, sine, cosine);
    const double scale =
        1.0 + p.kinematic_load_slope[0][j] * s.joint_torque[0][j] + p.kinematic_angle_modulation[0][j] * sine;
    k.kinematic[j] *= scale;
    k.kinematic_slope[j] *= scale;
    const double width = p.tooth_defect_width[0][j];
    if (p.tooth_defect_height[0][j] != 0.0) {
        double away = k.phi[j] - p.tooth_defect_position[0][j];
        away = (away - TURN * std::floor(away / TURN + 0.5)) / width;
        const double bump = p.tooth_defect_height[0][j] * exp_negative(-0.5 * away * away);
        k.kinematic[j] += bump;
        k.kinematic_slope[j] -= bump * away / width;
    }
}

template <int P>
void stiffen(const Parameters<P>& p, State<P>& s, const Derived<P>& d, Work<P>& k, int j) {
    const double delta = k.torsion[j], x = delta * delta;
    const double m1 = p.stiffness_linear[0][j], m2 = p.stiffness_cubic[0][j], m3 = p.stiffness_quintic[0][j];
    const Spring real = elastic(p, j, delta);
    double next[4];
    const Spring slip = slip_elements(p, s, j, k.hysteresis_step[j], next);
    for (int i = 0; i < 4; ++i) s.slip_torque[i][j] = next[i];
    k.torque_0[j] += real.torque + slip.torque - delta * (m1 + x * (m2 + x * m3));
    k.stiffening[j] += 0.25 * d.dt * (real.slope + slip.slope - (m1 + x * (3.0 * m2 + x * (5.0 * m3))));
}

// Bristle law, Zhu's plant: exact for a speed that is constant over the substep. Returns the friction torque.
template <int P>
double bristle(const Parameters<P>& p, State<P>& s, int j, double v, double level, double dt) {
    const double stiffness = p.bristle_stiffness[0][j], z = s.friction_memory[0][j];
    const double end = level / stiffness * (v > 0.0 ? 1.0 : (v < 0.0 ? -1.0 : 0.0));
    const double next = v == 0.0 ? z : end + (z - end) * exp_negative(-(stiffness * std::fabs(v) * dt / level));
    s.friction_memory[0][j] = next;
    return stiffness * next + p.bristle_damping[0][j] * (next - z) / dt;
}

// Generalised Maxwell-slip friction: four elements that stick and slip at different travels. Returns the torque.
template <int P>
double slip_friction(const Parameters<P>& p, State<P>& s, int j, double v, double level, double dt) {
    double sum = 0.0, sticking = 0.0;
    for (int i = 0; i < 4; ++i) {
        const double share = p.friction_slip_share[i][j], yield = share * level;
        const double trial = s.friction_memory[i][j] + yield / p.friction_slip_distance[i][j] * v * dt;
        const double torque = trial > yield ? yield : (trial < -yield ? -yield : trial);
        sticking += torque == trial ? share : 0.0;
        s.friction_memory[i][j] = torque;
        sum += torque;
    }
    return sum + p.bristle_damping[0][j] * sticking * v;
}

template <int P>
void change_friction(const Parameters<P>& p, State<P>& s, const Derived<P>& d, const Tick<P>& t, Work<P>& k, int j) {
    double sine, cosine;
    sin_cos(k.q[j] + p.friction_angle_phase[0][j], sine, cosine);
    const double level = k.level[j] * (1.0 + p.friction_angle_modulation[0][j] * sine);
    k.level[j] = level;
    const double law = p.friction_law[0][j];
    if (law == 0.0) {
        k.grip[j] = d.dt * (level + t.brake[j]);
        return;
    }
    const double v = k.v_ahead[j];
    k.grip[j] = d.dt * t.brake[j];
    k.momentum[j] -= d.dt * (law == 1.0 ? bristle(p, s, j, v, level, d.dt) : slip_friction(p, s, j, v, level, d.dt));
}

template <int P>
void load_motor(const Parameters<P>& p, const State<P>& s, const Derived<P>& d, Work<P>& k, int j) {
    const double share = s.current_torque[0][j] / p.torque_limit[0][j], theta = p.gear_ratio[0][j] * k.phi[j];
    double extra = -p.torque_constant_saturation[0][j] * share * share * s.current_torque[0][j];
    for (int i = 0; i < 2; ++i) {
        double sine, cosine;
        sin_cos(p.cogging_order[i][j] * theta + p.cogging_phase[i][j], sine, cosine);
        extra += p.cogging_amplitude[i][j] * sine;
    }
    k.drive_torque[j] += extra;
    k.momentum[j] += d.dt * extra;
}

template <int P>
void load_link(const Parameters<P>& p, State<P>& s, const Derived<P>& d, Work<P>& k, int j, double time) {
    double sine, cosine;
    sin_cos(p.cable_order[0][j] * k.q[j] + p.cable_phase[0][j], sine, cosine);
    double torque = p.cable_torque[0][j] * sine - p.link_viscous[0][j] * k.w[j];
    if (p.pulse_torque[0][j] != 0.0) {
        const double since = time - p.pulse_period[0][j] * std::floor(time / p.pulse_period[0][j]);
        sin_cos(0.5 * TURN * since / p.pulse_duration[0][j], sine, cosine);
        if (since < p.pulse_duration[0][j]) torque += p.pulse_torque[0][j] * sine;
    }
    if (p.link_coulomb[0][j] != 0.0) {
        const double stiffness = p.link_bristle_stiffness[0][j], level = p.link_coulomb[0][j], z = s.link_bristle[0][j];
        const double w = k.w[j], end = level / stiffness * (w > 0.0 ? 1.0 : (w < 0.0 ? -1.0 : 0.0));
        const double next = w == 0.0 ? z : end + (z - end) * exp_negative(-(stiffness * std::fabs(w) * d.dt / level));
        s.link_bristle[0][j] = next;
        torque -= stiffness * next + p.link_bristle_damping[0][j] * (next - z) / d.dt;
    }
    const double hung = p.resonance_inertia[0][j];
    if (hung != 0.0) {  // hanging inertia: semi-implicit, driven by the midpoint of the link
        const double rate = TURN * p.resonance_frequency[0][j], damping = 2.0 * p.resonance_damping[0][j] * rate;
        const double half = 0.5 * d.dt, along = s.resonance_position[0][j] + half * s.resonance_velocity[0][j];
        const double pull = rate * rate * (k.q[j] - along) + damping * (k.w[j] - s.resonance_velocity[0][j]);
        const double change = d.dt * pull / (1.0 + half * (damping + half * rate * rate));
        s.resonance_position[0][j] += d.dt * s.resonance_velocity[0][j] + half * change;
        s.resonance_velocity[0][j] += change;
        torque -= hung * change / d.dt;
    }
    k.extra_torque[j] += torque;
}

}  // namespace hd_sim
