// One-link arm with a harmonic drive and a torque sensor: Hashimoto (15)-(17), output side, bristle friction.
//
//   code           paper          code               paper
//   rotor          q_M / N        rotor_inertia      J = N^2 J_M
//   link           q_L            link_inertia       J_L; 0: the link is locked
//   joint_torque   T_J            friction           N tau_F
//
// Semi-implicit Euler in small substeps; the bristle follows its exact solution for the velocity of the substep.
#pragma once

#include <cmath>
#include <vector>

#include "blocks.hpp"

namespace hd_sim {

#define HD_ONE_LINK_ARM(FIELD)                                                        \
    FIELD(rotor_inertia, 0, "kg m^2", "J, output side")                               \
    FIELD(link_inertia, 0, "kg m^2", "J_L; 0: the link is locked")                    \
    FIELD(stiffness, 0, "N m/rad", "K")                                               \
    FIELD(coulomb_torque, 0, "N m", "N tau_F, output side")                           \
    FIELD(presliding_distance, 0, "rad", "x_pre of the bristle, output side")         \
    FIELD(bristle_damping, 0, "-", "factor on sqrt(bristle stiffness rotor inertia)") \
    FIELD(viscous, 0, "N m s", "viscous friction, output side")

HD_BLOCK(OneLinkParams, HD_ONE_LINK_ARM)

class OneLinkArm {
  public:
    explicit OneLinkArm(const std::vector<double>& numbers) : numbers_(numbers), p_(numbers_.data(), 1) {}
    OneLinkArm(const OneLinkArm&) = delete;
    OneLinkArm& operator=(const OneLinkArm&) = delete;

    void advance(double motor_torque, double dt, int steps) {
        for (int i = 0; i < steps; ++i) step(motor_torque, dt);
    }

    double rotor = 0.0, rotor_rate = 0.0, link = 0.0, link_rate = 0.0, bristle = 0.0;
    double joint_torque() const { return p_.stiffness[0] * (rotor - link); }

  private:
    void step(double motor_torque, double dt) {
        const double torque = joint_torque();
        rotor_rate += dt * (motor_torque - torque - friction(dt)) / p_.rotor_inertia[0];
        if (p_.link_inertia[0] > 0.0) link_rate += dt * torque / p_.link_inertia[0];
        rotor += dt * rotor_rate;
        link += dt * link_rate;
    }

    double friction(double dt) {
        const double level = p_.coulomb_torque[0];
        if (level == 0.0) return p_.viscous[0] * rotor_rate;
        const double stiffness = level / p_.presliding_distance[0], before = bristle;
        if (rotor_rate != 0.0) {
            const double full = std::copysign(p_.presliding_distance[0], rotor_rate);
            bristle = full + (before - full) * std::exp(-std::fabs(rotor_rate) * dt / p_.presliding_distance[0]);
        }
        const double damping = p_.bristle_damping[0] * std::sqrt(stiffness * p_.rotor_inertia[0]);
        return stiffness * bristle + damping * (bristle - before) / dt + p_.viscous[0] * rotor_rate;
    }

    std::vector<double> numbers_;
    OneLinkParams p_;
};

}  // namespace hd_sim
