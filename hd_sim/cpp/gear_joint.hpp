// One joint with kinematic error and hysteresis in the signs and letters of Gandhi and Ghorbel (8)-(10).
//
//   code                  paper      code                     paper
//   rotor, rotor_rate     theta_m    rotor_inertia, _damping  J_m, B_m
//   link, link_rate       theta_l    link_inertia, _damping   J_l, B_l
//   wind                  theta      ratio                    Y_p = 1/N - d theta_p / d theta_m
//   hysteresis            q          kinematic                theta_p
//   load_torque           tau_l      motor_torque             tau_m
//
// Mechanics: fourth-order Runge-Kutta. The hysteresis torque is no state of it: within a step it follows the wind-up
// from its value at the start of the step by the exact solution of (10), which needs no small step.
#pragma once

#include <cmath>
#include <vector>

#include "blocks.hpp"

namespace hd_sim {

constexpr int kGearHarmonics = 4;

#define HD_GEAR_JOINT(FIELD)                                                      \
    FIELD(rotor_inertia, 0, "kg m^2", "J_m, motor side")                          \
    FIELD(rotor_damping, 0, "N m s", "B_m, motor side")                           \
    FIELD(link_inertia, 0, "kg m^2", "J_l")                                       \
    FIELD(link_damping, 0, "N m s", "B_l")                                        \
    FIELD(gear_ratio, 0, "-", "N")                                                \
    FIELD(stiffness_linear, 0, "N m/rad", "K or m_1")                             \
    FIELD(stiffness_cubic, 0, "N m/rad^3", "m_2")                                 \
    FIELD(stiffness_quintic, 0, "N m/rad^5", "m_3")                               \
    FIELD(hysteresis_stiffness, 0, "N m/rad", "A")                                \
    FIELD(hysteresis_rate, 0, "1/rad", "alpha")                                   \
    FIELD(load_amplitude, 0, "N m", "load torque: amplitude sin(frequency time)") \
    FIELD(load_frequency, 0, "rad/s", "frequency of the load torque")             \
    FIELD(kinematic_phase, 0, "rad", "assembly phase added to the rotor angle")   \
    FIELD(kinematic_cosine, 4, "rad", "theta_p: cos n theta_m, n = 1 .. 4")       \
    FIELD(kinematic_sine, 4, "rad", "theta_p: sin n theta_m, n = 1 .. 4")

HD_BLOCK(GearJointParams, HD_GEAR_JOINT)

struct GearMotion {
    double rotor = 0.0, rotor_rate = 0.0, link = 0.0, link_rate = 0.0;
};

class GearJoint {
  public:
    explicit GearJoint(const std::vector<double>& numbers) : numbers_(numbers), p_(numbers_.data(), 1) {
        wind_ = wind(now_);
    }
    GearJoint(const GearJoint&) = delete;
    GearJoint& operator=(const GearJoint&) = delete;

    // `steps` of `dt` with the motor torque held; the load is a function of time.
    void advance(double motor_torque, double dt, int steps) {
        for (int i = 0; i < steps; ++i) step(motor_torque, dt);
    }

    const GearMotion& motion() const { return now_; }
    double time() const { return static_cast<double>(count_) * dt_; }
    double wind_up() const { return wind_; }
    double spring_torque() const { return spring(wind_) + hysteresis_; }

  private:
    struct Shape {
        double value = 0.0, slope = 0.0;
    };

    Shape kinematic(double rotor) const {
        Shape shape;
        const double angle = rotor + p_.kinematic_phase[0];
        for (int i = 0; i < kGearHarmonics; ++i) {
            const double n = i + 1, c = std::cos(n * angle), s = std::sin(n * angle);
            shape.value += p_.kinematic_cosine[i] * c + p_.kinematic_sine[i] * s;
            shape.slope += n * (p_.kinematic_sine[i] * c - p_.kinematic_cosine[i] * s);
        }
        return shape;
    }

    double wind(const GearMotion& m) const { return m.link - m.rotor / p_.gear_ratio[0] + kinematic(m.rotor).value; }

    double spring(double wind) const {
        const double square = wind * wind;
        return wind * (p_.stiffness_linear[0] + square * (p_.stiffness_cubic[0] + square * p_.stiffness_quintic[0]));
    }

    // (10) for a wind-up that moves monotonically from the start of the step.
    double hysteresis_at(double wind) const {
        const double way = wind - wind_, rate = p_.hysteresis_rate[0];
        if (rate == 0.0) return hysteresis_ + p_.hysteresis_stiffness[0] * way;
        const double level = std::copysign(p_.hysteresis_stiffness[0] / rate, way);
        return hysteresis_ + (hysteresis_ - level) * std::expm1(-rate * std::fabs(way));
    }

    GearMotion rates(const GearMotion& m, double motor_torque, double load_torque) const {
        const Shape shape = kinematic(m.rotor);
        const double wind = m.link - m.rotor / p_.gear_ratio[0] + shape.value;
        const double torque = spring(wind) + hysteresis_at(wind);
        const double ratio = 1.0 / p_.gear_ratio[0] - shape.slope;
        GearMotion rate;
        rate.rotor = m.rotor_rate;
        rate.link = m.link_rate;
        rate.rotor_rate = (motor_torque + torque * ratio - p_.rotor_damping[0] * m.rotor_rate) / p_.rotor_inertia[0];
        rate.link_rate = -(torque + load_torque + p_.link_damping[0] * m.link_rate) / p_.link_inertia[0];
        return rate;
    }

    static GearMotion moved(const GearMotion& m, const GearMotion& rate, double h) {
        return {m.rotor + h * rate.rotor, m.rotor_rate + h * rate.rotor_rate, m.link + h * rate.link,
                m.link_rate + h * rate.link_rate};
    }

    double load(double time) const { return p_.load_amplitude[0] * std::sin(p_.load_frequency[0] * time); }

    void step(double torque, double dt) {
        dt_ = dt;
        const double t = time(), start = load(t), middle = load(t + 0.5 * dt), end = load(t + dt);
        const GearMotion a = rates(now_, torque, start);
        const GearMotion b = rates(moved(now_, a, 0.5 * dt), torque, middle);
        const GearMotion c = rates(moved(now_, b, 0.5 * dt), torque, middle);
        const GearMotion d = rates(moved(now_, c, dt), torque, end);
        const GearMotion sum{a.rotor + 2.0 * (b.rotor + c.rotor) + d.rotor,
                             a.rotor_rate + 2.0 * (b.rotor_rate + c.rotor_rate) + d.rotor_rate,
                             a.link + 2.0 * (b.link + c.link) + d.link,
                             a.link_rate + 2.0 * (b.link_rate + c.link_rate) + d.link_rate};
        now_ = moved(now_, sum, dt / 6.0);
        const double after = wind(now_);
        hysteresis_ = hysteresis_at(after);
        wind_ = after;
        ++count_;
    }

    std::vector<double> numbers_;
    GearJointParams p_;
    GearMotion now_;
    double hysteresis_ = 0.0, wind_ = 0.0, dt_ = 0.0;
    long count_ = 0;
};

}  // namespace hd_sim
