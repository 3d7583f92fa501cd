// One substep of the drives: everything between the links' state and the torque on the links.
//
// Set-valued Coulomb friction, implicit transmission, reversals resolved inside the step. The step-average torque is
// linear in the unknown end velocities, tau = tau_0 + c_t [Y (v+ - v) - (w+ - w)], so rotor and spring are eliminated
// exactly: the links see a torque and an apparent armature. Zhu (1)-(4), Gandhi-Ghorbel (2), (4)-(6).
//
// Letters of the papers: v rotor speed at the output, w link speed, Y transmission slope, G Coulomb magnitude, KE
// kinematic error, h hysteresis torque, A and alpha its stiffness and rate, I* rotor inertia, I_e with implicit spring.
#pragma once

#include "fields.hpp"

namespace hd_sim {

// What changes once per tick at most.
template <int P>
struct Tick {
    alignas(16) double command[P] = {}, torque_gain[P] = {}, coulomb[P] = {}, viscous_positive[P] = {},
                       viscous_negative[P] = {}, brake[P] = {};
};

// Constants derived from the parameters for one step length.
template <int P>
struct Derived {
    double dt = 0.0, half = 0.0, rate = 0.0;  // s, s, 1/s
    double ahead = 0.0;                       // how far velocities are extrapolated, s; 0 in the first-order scheme
    alignas(16) double current_blend[P] = {}, gauge_blend[P] = {}, hysteresis_limit[P] = {}, stribeck_excess[P] = {},
                       stribeck_inverse[P] = {};
    bool stribeck = false;
};

// Intermediate results of the present substep.
template <int P>
struct Work {
    alignas(16) double phi[P], q[P], w[P], sin_q[P], cos_q[P], kinematic[P], kinematic_slope[P], slope[P], torsion[P],
        hysteresis[P], hysteresis_step[P], torque_0[P], stiffening[P], v_ahead[P], level[P], grip[P], e_positive[P],
        e_negative[P], drive_torque[P], inertia[P], momentum[P], pull[P], numerator[P], shift[P], inverse[P],
        link_torque[P], armature[P], acceleration[P], extra_torque[P];
};

// Step 1: midpoint angles, sines, kinematic error and its slope N dKE/dtheta.
template <int N>
void midpoint(const Parameters<Lanes<N>::padded>& p, const State<Lanes<N>::padded>& s,
              const Derived<Lanes<N>::padded>& d, Work<Lanes<N>::padded>& k) {
    using V = typename Lanes<N>::V;
    for (int j = 0; j < Lanes<N>::padded; j += Lanes<N>::width) {
        const V phi = load<V>(s.motor_position[0] + j) + d.half * load<V>(s.motor_velocity[0] + j);
        const V w = load<V>(s.joint_velocity[0] + j);
        const V q = load<V>(s.joint_position[0] + j) + d.half * w;
        const V ratio = load<V>(p.gear_ratio[0] + j);
        V s1, c1, sq, cq;
        sin_cos<V>(q, sq, cq);
        sin_cos<V>(ratio * phi, s1, c1);
        const V c2 = c1 * c1 - s1 * s1, s2 = 2.0 * s1 * c1, c3 = c2 * c1 - s2 * s1, s3 = s2 * c1 + c2 * s1;
        const V c4 = c2 * c2 - s2 * s2, s4 = 2.0 * s2 * c2;
        const V a1 = load<V>(p.kinematic_cosine[0] + j), b1 = load<V>(p.kinematic_sine[0] + j);
        const V a2 = load<V>(p.kinematic_cosine[1] + j), b2 = load<V>(p.kinematic_sine[1] + j);
        const V a3 = load<V>(p.kinematic_cosine[2] + j), b3 = load<V>(p.kinematic_sine[2] + j);
        const V a4 = load<V>(p.kinematic_cosine[3] + j), b4 = load<V>(p.kinematic_sine[3] + j);
        store<V>(k.phi + j, phi);
        store<V>(k.q + j, q);
        store<V>(k.w + j, w + d.ahead * load<V>(s.joint_acceleration[0] + j));
        store<V>(k.sin_q + j, sq);
        store<V>(k.cos_q + j, cq);
        store<V>(k.kinematic + j,
                 (a1 * c1 + b1 * s1) + (a2 * c2 + b2 * s2) + (a3 * c3 + b3 * s3) + (a4 * c4 + b4 * s4));
        store<V>(k.kinematic_slope + j, ratio * ((b1 * c1 - a1 * s1) + 2.0 * (b2 * c2 - a2 * s2) +
                                                 3.0 * (b3 * c3 - a3 * s3) + 4.0 * (b4 * c4 - a4 * s4)));
    }
}

// Steps 2 and 3: hysteresis, spring and damper at the midpoint; tau_0 and the stiffening c_t.
template <int N>
void transmission(const Parameters<Lanes<N>::padded>& p, const State<Lanes<N>::padded>& s,
                  const Derived<Lanes<N>::padded>& d, Work<Lanes<N>::padded>& k) {
    using V = typename Lanes<N>::V;
    for (int j = 0; j < Lanes<N>::padded; j += Lanes<N>::width) {
        const V Y = 1.0 + load<V>(k.kinematic_slope + j);
        const V delta = load<V>(k.phi + j) + load<V>(k.kinematic + j) - load<V>(k.q + j);
        const V D = delta - load<V>(s.torsion[0] + j);
        const V sign = choose(below(D, all<V>(0.0)), all<V>(-1.0), all<V>(1.0));
        const V alpha = load<V>(p.hysteresis_rate[0] + j), A = load<V>(p.hysteresis_stiffness[0] + j);
        const V saturated = sign * load<V>(d.hysteresis_limit + j);
        const V h =
            saturated + (load<V>(s.hysteresis_torque[0] + j) - saturated) * exp_negative<V>(-(alpha * magnitude(D)));
        const V m1 = load<V>(p.stiffness_linear[0] + j), m2 = load<V>(p.stiffness_cubic[0] + j);
        const V m3 = load<V>(p.stiffness_quintic[0] + j), k_d = load<V>(p.torsional_damping[0] + j);
        const V x = delta * delta, v = load<V>(s.motor_velocity[0] + j), w = load<V>(s.joint_velocity[0] + j);
        const V k_t = m1 + x * (3.0 * m2 + x * (5.0 * m3)) + A - alpha * sign * h;
        store<V>(k.slope + j, Y);
        store<V>(k.torsion + j, delta);
        store<V>(k.hysteresis_step + j, D);
        store<V>(k.hysteresis + j, h);
        store<V>(k.torque_0 + j, delta * (m1 + x * (m2 + x * m3)) + h + k_d * (Y * v - w));
        store<V>(k.stiffening + j, 0.25 * d.dt * k_t + 0.5 * k_d);
    }
}

// Step 4: Coulomb magnitude at the extrapolated midpoint, and the viscous halves e of the step.
template <int N>
void friction(const Parameters<Lanes<N>::padded>& p, const State<Lanes<N>::padded>& s,
              const Derived<Lanes<N>::padded>& d, const Tick<Lanes<N>::padded>& t, Work<Lanes<N>::padded>& k) {
    using V = typename Lanes<N>::V;
    for (int j = 0; j < Lanes<N>::padded; j += Lanes<N>::width) {
        const V v = load<V>(s.motor_velocity[0] + j), v_a = load<V>(s.motor_acceleration[0] + j);
        const V straight = v + d.ahead * v_a;
        const V v_h = choose(below(straight * v, all<V>(0.0)), all<V>(0.0), straight);
        const V tau_h =
            load<V>(k.torque_0 + j) + load<V>(k.stiffening + j) * (2.0 * d.ahead) *
                                          (load<V>(k.slope + j) * v_a - load<V>(s.joint_acceleration[0] + j));
        const V load_factor = 1.0 + load<V>(p.load_friction_linear[0] + j) * magnitude(tau_h) +
                              load<V>(p.load_friction_quadratic[0] + j) * (tau_h * tau_h);
        V G = load<V>(t.coulomb + j) * load_factor;
        if (d.stribeck) {
            const V ratio = v_h * load<V>(d.stribeck_inverse + j);
            G = G * (1.0 + load<V>(d.stribeck_excess + j) * exp_negative<V>(-(ratio * ratio)));
        }
        const V drag = load<V>(p.quadratic_drag[0] + j) * magnitude(v_h);
        store<V>(k.v_ahead + j, straight);
        store<V>(k.level + j, G);
        store<V>(k.grip + j, d.dt * (G + load<V>(t.brake + j)));
        store<V>(k.e_positive + j, d.half * (load<V>(t.viscous_positive + j) + drag));
        store<V>(k.e_negative + j, d.half * (load<V>(t.viscous_negative + j) + drag));
    }
}

// Current loop and step 5 without the modes: I_e, R and the factor of qdd in b(qdd) = R + dt Y c_t dt qdd.
template <int N>
void rotor_balance(const Parameters<Lanes<N>::padded>& p, State<Lanes<N>::padded>& s,
                   const Derived<Lanes<N>::padded>& d, const Tick<Lanes<N>::padded>& t, Work<Lanes<N>::padded>& k) {
    using V = typename Lanes<N>::V;
    for (int j = 0; j < Lanes<N>::padded; j += Lanes<N>::width) {
        V u_a = load<V>(s.current_torque[0] + j);
        u_a = u_a + (load<V>(t.command + j) - u_a) * load<V>(d.current_blend + j);
        store<V>(s.current_torque[0] + j, u_a);
        const V u = load<V>(t.torque_gain + j) * u_a + load<V>(s.external_motor_torque[0] + j);
        const V Y = load<V>(k.slope + j), c_t = load<V>(k.stiffening + j), v = load<V>(s.motor_velocity[0] + j);
        const V I = load<V>(p.rotor_inertia[0] + j), bend = Y * c_t;
        store<V>(k.drive_torque + j, u);
        store<V>(k.inertia + j, I + d.dt * (Y * bend));
        store<V>(k.pull + j, (d.dt * d.dt) * bend);
        store<V>(k.momentum + j,
                 I * v + d.dt * (u - load<V>(p.friction_offset[0] + j) - Y * (load<V>(k.torque_0 + j) - bend * v)));
    }
}

}  // namespace hd_sim
