// What stands for the drives' electronics in front of the simulated plant: newest command, second guard, command
// watchdog, brake. It is the last code before the model, and it believes nothing of the controller.
//
// Tick k: the newest command, normally that of tick k-1, is latched for [k, k+1), then the sensors are sampled, then the
// interval is integrated. What it decides, and why: hd_sim/drive_side.py.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <vector>

#include "fault_rows.hpp"
#include "fields.hpp"
#include "guard.hpp"
#include "world.hpp"

namespace hd_sim {

constexpr std::int64_t kNever = -1;
constexpr int kArmingSamples = 100;       // healthy commands in a row before the drives obey
constexpr double kLetGoSamples = 3.0;     // commands of exactly zero in a row for a moving joint that close the brakes
constexpr double kMovingSpeed = 0.05;     // rad/s; above what the quantisation of a 16-bit joint sensor looks like
constexpr double kSlipTime = 0.05;        // s after a brake opened in which no joint may move by
constexpr double kSlipDistance = 1e-3;    // rad
constexpr int kCarryPatience = 100;       // samples in which a command may come to carry the arm
constexpr int kStrangerSamples = 1000;    // after a command of another source the drives are not armed
constexpr double kVelocityWeight = 0.18;  // share of a new difference: a low-pass of 200 rad/s at 1 kHz

enum DriveState { kConnecting = 0, kWarming = 1, kArmed = 2, kStopped = 3 };

class DriveSide {
  public:
    // `position_at`, `velocity_at`: where the true joint angles and rates lie in the plant's state.
    DriveSide(World& world, int joints, double period, const double* gate_limits, const double* guard_limits,
              const double* bounds, const double* gear_ratio, std::size_t state_size, std::size_t position_at,
              std::size_t velocity_at, std::size_t before, std::size_t after)
        : n(joints),
          guard(gate_limits, guard_limits, bounds, joints, period,
                hd::GuardLimits(const_cast<double*>(guard_limits), joints).brake_samples[0]),
          table(joints),
          ring(2 * (before + 1 + after)),
          rows(64 * joints + 16),
          incoming(static_cast<std::size_t>(joints), 0.0),
          command(incoming),
          applied(incoming),
          readings(PlantSample::size(joints), 0.0),
          positions(static_cast<std::size_t>(2 * joints), 0.0),
          velocities(positions),
          true_position(command),
          watched_command(command),
          watched_readings(readings),
          command_tick(static_cast<std::size_t>(joints), kNever),
          world_(world),
          gear_ratio_(gear_ratio, gear_ratio + joints),
          rate_(kVelocityWeight / period),
          slip_samples_(static_cast<int>(std::nearbyint(kSlipTime / period))),
          opened_at_(command),
          zero_run_(command),
          ages_(command),
          no_age_(command),
          ticks_(command),
          state_(state_size),
          position_at_(position_at),
          velocity_at_(velocity_at) {
        ring.watch(watched_command.data(), watched_command.size());
        ring.watch(watched_readings.data(), watched_readings.size());
    }
    DriveSide(const DriveSide&) = delete;
    DriveSide& operator=(const DriveSide&) = delete;

    // Takes commands for some joints (all: `count` = n, `joints` null); one not newer than the last is dropped, and so is
    // one of a tick whose sensors were not read yet: it would keep the watchdog quiet until then.
    bool offer(const int* joints, int count, const double* torque, std::int64_t tick) {
        if (tick > now_) {
            ++ahead;
            lead_ = std::max(lead_, tick - now_);
            return false;
        }
        std::int64_t last = kNever;
        if (joints == nullptr)
            last = newest;
        else
            for (int i = 0; i < count; ++i) last = std::max(last, command_tick[at(joints[i])]);
        if (last >= tick) {
            ++stale;
            return false;
        }
        for (int i = 0; i < count; ++i) {
            const std::size_t j = at(joints == nullptr ? i : joints[i]);
            command[j] = torque[i];
            command_tick[j] = tick;
        }
        oldest = joints == nullptr ? tick : *std::min_element(command_tick.begin(), command_tick.end());
        newest = std::max(newest, tick);
        return true;
    }
    // What the drives do with commands now. Armed: they obey, and the brakes are open.
    int state() const {
        if (guard.stopped()) return kStopped;
        if (open && !brake_closed) return kArmed;
        return newest == kNever ? kConnecting : kWarming;
    }
    bool complete(std::int64_t tick) const { return oldest >= tick; }

    // Somebody else sends commands, too: whose are right is not known, so the drives are not armed now.
    void stranger() {
        ++strangers;
        stranger_left_ = kStrangerSamples;
    }
    // May another source take over? While the robot is stopped, or before it was armed if the one before is silent.
    bool stands() const { return guard.stopped() || (!open && now_ - newest > kArmingSamples); }

    // Gives the drives their torque for [tick, tick + 1); findings of the guard are `rows`.
    void latch(std::int64_t tick) {
        rows.count = 0;
        begin(tick);
        if (!open) arm(tick);
        const double* ages = no_age_.data();
        if (oldest < tick - 1) {
            for (int j = 0; j < n; ++j)
                ages_[at(j)] = (static_cast<double>(tick) - 1.0) - static_cast<double>(command_tick[at(j)]);
            ages = ages_.data();
            late += open ? 1 : 0;
        }
        std::fill(ticks_.begin(), ticks_.end(), static_cast<double>(tick));
        if (slip_left_ > 0) slip();
        if (open && std::any_of(command.begin(), command.end(), [](double u) { return u == 0.0; })) let_go();
        guard.step(command.data(), ages, ticks_.data(), applied.data(), rows);
        if (brake_closed || rows.count > 0) move_brake();
        world_.latch(applied.data());
    }

    // The sensors now, after `latch`; positions and velocities for the guard follow them.
    void sample() {
        world_.sample(readings.data());
        const PlantSample seen(readings.data(), n);
        for (int i = 0; i < 2 * n; ++i) {
            const double before = positions[at(i)];
            positions[at(i)] = i < n ? seen.motor_shaft_position[i] / gear_ratio_[at(i)] : seen.joint_position[i - n];
            if (sensed_) velocities[at(i)] += (positions[at(i)] - before) * rate_ - kVelocityWeight * velocities[at(i)];
        }
        sensed_ = true;
        for (int j = 0; j < n; ++j) {
            guard.seen.motor_position[j] = positions[at(j)];
            guard.seen.joint_position[j] = positions[at(n + j)];
            guard.seen.motor_velocity[j] = velocities[at(j)];
            guard.seen.joint_velocity[j] = velocities[at(n + j)];
        }
    }

    // One tick up to the readings: a reset that was asked for, latch, sample, black box.
    void measure(std::int64_t tick) {
        if (reset_asked.load(std::memory_order_acquire)) answer_reset();
        latch(tick);
        if (open && rows.count > 0) table.note(rows, static_cast<double>(tick));
        sample();
        std::copy(command.begin(), command.end(), watched_command.begin());
        std::copy(readings.begin(), readings.end(), watched_readings.begin());
        const double* known = table.stop_tick >= 0.0 ? table.stop.data() : hd::kUnknownStop;
        ring.note(static_cast<double>(tick), guard.stopped() ? known : nullptr);
    }
    void advance() { world_.advance(); }

    // What no sensor shows, for checks of a run: the true joint position before the tick.
    void look() {
        world_.write_state(state_.data());
        const double* from = state_.data() + position_at_;
        std::copy(from, from + n, true_position.begin());
    }

    // A loop without delay, which no real one is: the chain's command acts in the tick of its own sample.
    void advance_promptly() {
        world_.latch(incoming.data());
        world_.advance();
    }

    // Ends a latched stop if the inputs run and the joints rest; rows of the reasons against it.
    int reset(const double* joint_velocity, double* refusals) {
        std::copy(joint_velocity, joint_velocity + n, guard.seen.joint_velocity);
        return guard.reset(refusals, false);
    }

    const int n;
    hd::Guard guard;
    hd::FaultTable table;
    hd::RowRing ring;
    hd::OwnRows rows;
    std::vector<double> incoming;  // of a run without topics: the chain's command, until it is taken
    std::vector<double> command, applied, readings, positions, velocities, true_position, watched_command,
        watched_readings;
    std::vector<std::int64_t> command_tick;
    std::int64_t oldest = kNever, newest = kNever;
    bool open = false, brake_closed = true;
    long late = 0, stale = 0, ahead = 0, strangers = 0;
    int healthy = 0;
    std::atomic<bool> reset_asked{false};
    std::atomic<int> resets{0};
    std::vector<double> refusals = std::vector<double>(static_cast<std::size_t>(4 * (2 * n + 1)));
    int refused = 0;

  private:
    static std::size_t at(int i) { return static_cast<std::size_t>(i); }

    // Time goes on to `tick`; if it went back, what was commanded belongs to another time.
    void begin(std::int64_t tick) {
        if (lead_ > 0) rows.add(hd::kStampAhead, -1, static_cast<double>(lead_), 0.0, hd::kReport);
        lead_ = 0;
        if (tick < now_) {
            std::fill(command_tick.begin(), command_tick.end(), kNever);
            oldest = newest = kNever;
        }
        now_ = tick;
    }

    // Opens after `kArmingSamples` ticks in a row with a command that was at most one sample late.
    void arm(std::int64_t tick) {
        healthy = oldest > kNever && oldest >= tick - 2 && stranger_left_ == 0 ? healthy + 1 : 0;
        if (stranger_left_ > 0) --stranger_left_;
        if (healthy < kArmingSamples) return;
        guard.activate(no_age_.data());
        open = true;
    }

    // Joints that move although the controller asks for exactly no torque.
    void let_go() {
        for (int j = 0; j < n; ++j) {
            const bool still = std::fabs(guard.seen.motor_velocity[j]) <= kMovingSpeed &&
                               std::fabs(guard.seen.joint_velocity[j]) <= kMovingSpeed;
            zero_run_[at(j)] = command[at(j)] == 0.0 && !still ? zero_run_[at(j)] + 1.0 : 0.0;
            if (zero_run_[at(j)] >= kLetGoSamples)
                rows.add(hd::kLetGo, j, zero_run_[at(j)], kLetGoSamples, hd::kControlledStop);
        }
    }

    // The brakes open for a command that leaves the guard as it came and carries what the gauges show the gears carry.
    void move_brake() {
        const bool through = open && std::equal(applied.begin(), applied.end(), command.begin());
        const bool carried = brake_closed && through && carries();
        const bool wanted = guard.stopped() || (brake_closed && !carried);
        waiting_ = brake_closed && wanted && through && !guard.stopped() ? waiting_ + 1 : 0;
        if (waiting_ >= kCarryPatience) report_load();
        if (wanted == brake_closed) return;
        brake_closed = wanted;
        world_.brake(wanted);
        slip_left_ = wanted ? 0 : slip_samples_;
        std::copy(positions.begin() + n, positions.end(), opened_at_.begin());
    }

    // N m of the command beyond what the gear of a joint carries.
    double beyond(int j) const { return command[at(j)] - PlantSample(const_cast<double*>(readings.data()), n).gauge_torque[j]; }

    bool carries() const {
        bool found = sensed_;
        for (int j = 0; j < n; ++j) found &= std::fabs(beyond(j)) <= guard.guard_limits.carry_tolerance[j];
        return found;
    }

    void report_load() {
        for (int j = 0; j < n; ++j) {
            const double tolerance = guard.guard_limits.carry_tolerance[j];
            if (!(std::fabs(beyond(j)) <= tolerance)) rows.add(hd::kBrakeHeld, j, beyond(j), tolerance, hd::kReport);
        }
    }

    // A joint that moves as soon as its brake is open: its torque does not hold it.
    void slip() {
        --slip_left_;
        for (int j = 0; j < n; ++j) {
            const double moved = positions[at(n + j)] - opened_at_[at(j)];
            if (!(std::fabs(moved) <= kSlipDistance)) rows.add(hd::kSlipped, j, moved, kSlipDistance, hd::kControlledStop);
        }
    }

    void answer_reset() {
        world_.write_state(state_.data());
        refused = reset(state_.data() + velocity_at_, refusals.data());
        if (refused == 0) table.clear();
        reset_asked.store(false, std::memory_order_relaxed);
        resets.fetch_add(1, std::memory_order_release);
    }

    World& world_;
    std::vector<double> gear_ratio_;
    double rate_;
    int slip_samples_, slip_left_ = 0, waiting_ = 0, stranger_left_ = 0;
    std::vector<double> opened_at_;  // rad, joints when the brakes opened
    std::vector<double> zero_run_, ages_, no_age_, ticks_, state_;
    std::size_t position_at_, velocity_at_;
    bool sensed_ = false;
    std::int64_t now_ = kNever, lead_ = 0;  // tick of the last latch; how far ahead of it commands were since then
};

}  // namespace hd_sim
