// The world of N joints: parameters, state, one tick, one sample. All memory is fixed; nothing is allocated per tick.
#pragma once

#include <memory>

#include "modes.hpp"
#include "rigid.hpp"
#include "sensors.hpp"
#include "world.hpp"

namespace hd_sim {

struct Options {
    double dt = 0.0;           // s, one substep
    int substeps = 0;          // per tick
    int reported_delay = 0;    // ticks that the drive declares
    bool first_order = false;  // the simple scheme, as an independent limit for accuracy tests
    bool accounts = false;     // keep work accounts (motor, friction, damping, hysteresis)
    std::uint64_t keys[STREAMS] = {};
};

// The transmission of one joint at the end of a step, from the constitutive law.
struct Transmitted {
    double torque, torsion, hysteresis, kinematic, slope;
};

template <int N>
class Plant final : public World {
    static constexpr int P = Lanes<N>::padded;
    using V = typename Lanes<N>::V;

  public:
    Plant(const double* parameters, const Options& options) : o_(options) {
        read_block<P>(p_, parameters, N);
        d_.dt = o_.dt;
        d_.half = 0.5 * o_.dt;
        d_.rate = 1.0 / o_.dt;
        d_.ahead = o_.first_order ? 0.0 : d_.half;
        for (int j = 0; j < P; ++j) derive(j);
        effects_.find(p_, N, 0.5 * o_.dt);
        build_arm();
        for (int j = 0; j < N; ++j) s_.temperature[0][j] = p_.ambient_temperature[0][j];
    }

    void write_state(double* flat) const override { write_block<P>(s_, flat, N); }
    void read_state(const double* flat) override { read_block<P>(s_, flat, N); }

    void latch(const double* command) override {
        const int slot = static_cast<int>(s_.tick[0][0]) % DELAY_TICKS;
        for (int j = 0; j < N; ++j) {
            const double limit = p_.torque_limit[0][j], u = command[j];
            s_.commands[slot][j] = std::isfinite(u) ? (u > limit ? limit : (u < -limit ? -limit : u)) : 0.0;
        }
    }

    void brake(bool engage) override {
        for (int j = 0; j < N; ++j) {
            if (!engage || s_.brake_request[0][j] == 0.0) s_.brake_age[0][j] = 0.0;
            s_.brake_request[0][j] = engage ? 1.0 : 0.0;
        }
    }

    void external(const double* joint_torque, const double* motor_torque) override {
        for (int j = 0; j < N; ++j) {
            s_.external_joint_torque[0][j] = joint_torque[j];
            s_.external_motor_torque[0][j] = motor_torque[j];
        }
    }

    void advance() override {
        begin_tick();
        for (int i = 0; i < o_.substeps; ++i) substep(i);
        end_tick();
    }

    void start(const double* pose, const double* torque, bool motor_side) override;
    void sample(double* flat) override;
    void truth(double* flat) override;
    void accelerate(const double* q, const double* w, const double* torque, const double* armature,
                    double* acceleration, double* inertia, double* bias) override;

  private:
    void derive(int j);
    void build_arm();
    void begin_tick();
    void end_tick();
    void substep(int index);
    void add_effects_before_friction();
    void add_effects_after_balance(double time);
    void delayed_commands(int index);
    void classify_all(Mode* modes);
    void adopt(const Mode* modes);
    void solve_links();
    void finish();
    void account(int j, double v, double v_end, double w, double w_end);
    Transmitted at_end(int j) const;
    double time() const { return s_.tick[0][0] * o_.dt * o_.substeps; }
    int slot(int ticks_ago) const {
        return (static_cast<int>(s_.tick[0][0]) + 64 * DELAY_TICKS - ticks_ago) % DELAY_TICKS;
    }

    Options o_;
    Parameters<P> p_{};
    State<P> s_{};
    Derived<P> d_{};
    Tick<P> t_{};
    Work<P> k_{};
    Effects<P> effects_{};
    Arm<N> arm_{};
    Mode modes_[N] = {};
};

}  // namespace hd_sim

#include "plant_step.hpp"
#include "plant_tick.hpp"
