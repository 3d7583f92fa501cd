// The closed loop of an ordinary run without Python between the ticks: world, fusion, motion law, torque law, both
// gates.
//
// The same compiled laws in the same order as hd_sim/runner.py, bit for bit; left out are the monitors of sensors and
// adaptation and the black boxes, which only watch. What is not ordinary (a guard speaks, a gate stops, a joint has
// lost its reference, a moving joint is let go) ends the run; nothing is reset here.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "fusion.hpp"
#include "motion.hpp"
#include "plant.hpp"
#include "safety.hpp"
#include "spline.hpp"
#include "torque_adaptive.hpp"

namespace hd_sim {

// Gate and guard of one side of the wire; arrays (n,) belong to the caller.
class GuardedSide {
  public:
    GuardedSide(double* gate_limits, double* gate_state, double* last_tick, const double* bounds, double age_limit,
                int joints)
        : limits_(gate_limits, joints),
          state_(gate_state, joints),
          last_tick_(last_tick),
          low_(bounds),
          age_limit_(age_limit),
          n_(joints),
          no_age_(joints, 0.0),
          ticks_(joints, 0.0),
          rows_(static_cast<std::size_t>(joints * hd::kFaultsPerJoint * hd::kFaultFields)) {}

    // False: something is to be judged, and nothing has left. `bounds` are rows low, high, speed, twice deceleration.
    bool pass(const double* command, double tick, const double* position, const double* velocity, double* out) {
        for (double& each : ticks_) each = tick;
        const hd::GuardLook look{command, no_age_.data(), ticks_.data(), last_tick_,    position,   velocity,
                                 low_,    low_ + n_,      low_ + 2 * n_, low_ + 3 * n_, age_limit_, hd::kLargestTick};
        if (!hd::guard_is_quiet(look, n_)) return false;
        hd::FaultRows faults{rows_.data(), hd::kFaultsPerJoint * n_};
        hd::SafetyGate gate{limits_, state_, faults, n_};
        gate.run(command, no_age_.data(), ticks_.data(), out);
        for (int j = 0; j < n_; ++j) last_tick_[j] = tick;
        return state_.stopped[0] == 0.0;
    }

  private:
    hd::GateLimits limits_;
    hd::GateState state_;
    double* last_tick_;
    const double* low_;
    double age_limit_;
    int n_;
    std::vector<double> no_age_, ticks_, rows_;
};

// The reference: rest until the start, a spline until its last knot, its last point after that.
struct Reference {
    hd::Spline spline;
    double start_tick;
    const double *rest, *end;  // position; position, velocity, acceleration
    std::size_t cursor = 0;

    void at(double tick, double dt, double* out) {
        const double offset = tick - start_tick, last = spline.segments ? spline.knots[spline.segments] : 0.0;
        const int n = spline.joints;
        if (offset < 0.0) {
            for (int i = 0; i < 3 * n; ++i) out[i] = i < n ? rest[i] : 0.0;
        } else if (spline.segments && offset < last) {
            cursor = hd::evaluate(spline, offset, dt, cursor, out);
        } else {
            for (int i = 0; i < 3 * n; ++i) out[i] = i < n || offset == last ? end[i] : 0.0;
        }
    }
};

// The drive's own sensing for its guard: positions of motor and joint, first-order velocities.
struct DriveSense {
    double *positions, *velocities;  // 2n each, motor then joint
    const double* gear_ratio;
    double rate, weight;

    void update(const PlantSample& sample, int n) {
        for (int i = 0; i < 2 * n; ++i) {
            const double before = positions[i];
            positions[i] = i < n ? sample.motor_shaft_position[i] / gear_ratio[i] : sample.joint_position[i - n];
            velocities[i] += (positions[i] - before) * rate - weight * velocities[i];
        }
    }
};

// Everything that the loop reads and carries on; the flat arrays are the blocks of the stages.
struct LoopMemory {
    double *fusion_params, *fusion_state, *motion_params, *motion_state, *torque_params, *torque_state, *command,
        *temperature;
    double dt, lost_tolerance, moving_speed;
    int temperature_ticks, let_go_samples;
    bool prompt;  // the command of a sample acts at once
};

// Rows of the run, (ticks, n): true joint position, desired position, command; torque state (ticks, size).
struct LoopRows {
    double *true_position, *desired, *command, *torque_state;
};

class ClosedLoop {
  public:
    ClosedLoop(World& world, const LoopMemory& memory, GuardedSide& control, GuardedSide& drive, DriveSense& sense,
               Reference& reference, std::size_t state_size, std::size_t position_at, int joints)
        : world_(world),
          m_(memory),
          control_(control),
          drive_(drive),
          sense_(sense),
          reference_(reference),
          n_(joints),
          position_at_(position_at),
          world_state_(state_size),
          readings_(PlantSample::size(joints)),
          fusion_in_(hd::FusionSample::size(joints)),
          fusion_out_(hd::FusionOutput::size(joints)),
          motion_in_(hd::MotionSample::size(joints)),
          motion_ref_(hd::MotionReference::size(joints)),
          motion_out_(hd::MotionOutput::size(joints)),
          motion_next_(hd::MotionState::size(joints)),
          torque_in_(hd::TorqueSample::size(joints)),
          torque_ref_(hd::TorqueReference::size(joints)),
          torque_out_(hd::TorqueOutput::size(joints)),
          applied_(joints),
          zero_run_(joints, 0) {}

    // Ticks that were ordinary, at most `ticks`, from tick `first` on.
    std::size_t run(long first, std::size_t ticks, const LoopRows& rows) {
        for (std::size_t k = 0; k < ticks; ++k) {
            world_.write_state(world_state_.data());
            copy(&world_state_[position_at_], rows.true_position + k * n_);
            if (!tick(first + static_cast<long>(k))) return k;
            copy(motion_ref_.data(), rows.desired + k * n_);
            copy(m_.command, rows.command + k * n_);
            if (rows.torque_state != nullptr) {
                const std::size_t size = hd::TorqueState::size(n_);
                std::copy(m_.torque_state, m_.torque_state + size, rows.torque_state + k * size);
            }
        }
        return ticks;
    }

  private:
    void copy(const double* from, double* to) const { std::copy(from, from + n_, to); }

    bool tick(long now) {
        const double t = static_cast<double>(now);
        if (lets_go()) return false;
        if (!drive_.pass(m_.command, t, sense_.positions + n_, sense_.velocities + n_, applied_.data())) return false;
        world_.latch(applied_.data());
        world_.sample(readings_.data());
        const PlantSample readings(readings_.data(), n_);
        sense_.update(readings, n_);
        if (now % m_.temperature_ticks == 0) copy(readings.motor_temperature, m_.temperature);
        if (!laws(readings, t)) return false;
        if (m_.prompt) world_.latch(m_.command);
        world_.advance();
        return true;
    }

    // Exactly no torque for a joint that moves, some samples in a row: the drives would close the brakes.
    bool lets_go() {
        bool some = false;
        for (int j = 0; j < n_; ++j) some |= m_.command[j] == 0.0;
        bool found = false;
        for (int j = 0; some && j < n_; ++j) {
            const double motor = std::fabs(sense_.velocities[j]), joint = std::fabs(sense_.velocities[n_ + j]);
            const bool moves = !(motor <= m_.moving_speed && joint <= m_.moving_speed);
            zero_run_[j] = m_.command[j] == 0.0 && moves ? zero_run_[j] + 1 : 0;
            found |= zero_run_[j] >= m_.let_go_samples;
        }
        return found;
    }

    bool laws(const PlantSample& readings, double t) {
        hd::FusionSample in(fusion_in_.data(), n_);
        copy(readings.motor_shaft_position, in.motor_shaft_position);
        copy(readings.joint_position, in.joint_position);
        copy(readings.gauge_torque, in.gauge_torque);
        copy(readings.motor_torque_applied, in.motor_torque);
        copy(m_.temperature, in.motor_temperature);
        hd::FusionOutput state(fusion_out_.data(), n_);
        hd::FusionState fusion(m_.fusion_state, n_);
        hd::fusion_step(hd::FusionParams(m_.fusion_params, n_), fusion, in, state, n_, m_.dt);
        for (int j = 0; j < n_; ++j)
            if (std::fabs(motion_ref_[j] - state.joint_position[j]) > m_.lost_tolerance && started_) return false;
        started_ = true;

        hd::MotionSample place(motion_in_.data(), n_);
        copy(state.joint_position, place.joint_position);
        copy(state.joint_velocity, place.joint_velocity);
        reference_.at(t, m_.dt, motion_ref_.data());
        hd::motion_step(hd::MotionParams(m_.motion_params, n_), m_.motion_state, place,
                        hd::MotionReference(motion_ref_.data(), n_), motion_out_.data(), motion_next_.data(), n_,
                        m_.dt);
        std::copy(motion_next_.begin(), motion_next_.end(), m_.motion_state);
        return torque(state, t);
    }

    bool torque(const hd::FusionOutput& state, double t) {
        const hd::MotionOutput wanted(motion_out_.data(), n_);
        hd::TorqueSample in(torque_in_.data(), n_);
        copy(state.joint_position, in.joint_position);
        copy(state.joint_velocity, in.joint_velocity);
        copy(state.joint_torque, in.joint_torque);
        copy(state.motor_position, in.motor_position);
        copy(state.motor_velocity, in.motor_velocity);
        copy(state.motor_torque, in.motor_torque);
        hd::TorqueReference ref(torque_ref_.data(), n_);
        copy(wanted.joint_torque_required, ref.joint_torque_required);
        copy(wanted.desired_position, ref.desired_position);
        copy(wanted.desired_velocity, ref.desired_velocity);
        std::fill(torque_out_.begin(), torque_out_.end(), 0.0);
        hd::TorqueOutput out(torque_out_.data(), n_);
        hd::TorqueState memory(m_.torque_state, n_);
        hd::torque_step(hd::TorqueParams(m_.torque_params, n_), memory, in, ref, out, n_, m_.dt);
        return control_.pass(out.motor_torque, t, in.joint_position, in.joint_velocity, m_.command);
    }

    World& world_;
    LoopMemory m_;
    GuardedSide &control_, &drive_;
    DriveSense& sense_;
    Reference& reference_;
    int n_;
    std::size_t position_at_;
    std::vector<double> world_state_, readings_, fusion_in_, fusion_out_, motion_in_, motion_ref_, motion_out_,
        motion_next_, torque_in_, torque_ref_, torque_out_, applied_;
    std::vector<int> zero_run_;
    bool started_ = false;
};

}  // namespace hd_sim
