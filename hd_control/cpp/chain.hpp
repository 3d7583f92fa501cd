// The tick: fusion, motion law, torque law with their monitors, guard and gate, on blocks. The one place.
//
//     sensors ─► FusionTick ─► MotionTick ─► TorqueTick ─► command
//
// Nodes with one or several stages, the process `chain`, the runner without ROS, replay and campaigns all call these
// objects. No allocation, exception, lock or clock in `act`; what is found leaves as rows (fault_rows.hpp). Everything
// that another thread asks for (new parameters, a path, a reset, a mode) is a pointer or a number that `act` takes
// between two ticks.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "fault_rows.hpp"
#include "follower.hpp"
#include "fusion.hpp"
#include "guard.hpp"
#include "integral_manifold.hpp"
#include "motion.hpp"
#include "parameter_ramp.hpp"
#include "sensor_watch.hpp"
#include "step.hpp"
#include "torque_adaptive.hpp"
#include "torque_feedback.hpp"

namespace hd {

// ------------------------------------------------------------------------------------------------ fusion

class FusionTick {
  public:
    FusionTick(int joints, double dt, const double* guard_limits, RampPlan plan)
        : n(joints),
          dt(dt),
          sample(FusionSample::size(joints), 0.0),
          raw(sample.size(), 0.0),
          output(FusionOutput::size(joints), 0.0),
          state(FusionState::size(joints), 0.0),
          params(FusionParams::size(joints), std::move(plan), dt),
          watch(guard_limits, joints),
          table(joints),
          rows(64 * joints + 16) {
        FusionSample(sample.data(), n).motor_temperature[0] = NAN;
        std::fill_n(FusionSample(sample.data(), n).motor_temperature, n, NAN);
    }

    void start() {
        params.arrive();
        watch.adopt(FusionParams(params.goal().data(), n));
        watch.start();
        tick = -1;
        has_state = false;
    }

    void act(std::int64_t now) {
        raw = sample;
        rows.count = 0;
        FusionSample in(sample.data(), n);
        watch.before(in, rows);
        watch.temperatures(in, dt, rows);
        if (params.changes() && params.take(has_state ? state.data() : nullptr))
            watch.adopt(FusionParams(params.goal().data(), n));
        if (!has_state) std::fill(state.begin(), state.end(), 0.0);
        has_state = true;
        FusionState memory(state.data(), n);
        FusionOutput out(output.data(), n);
        std::fill(output.begin(), output.end(), 0.0);
        fusion_step(FusionParams(params.now.data(), n), memory, in, out, n, dt);
        watch.after(in, out, now, rows);
        tick = now;
        if (rows.count > 0) table.note(rows, static_cast<double>(now));
    }

    const int n;
    const double dt;
    std::vector<double> sample, raw, output, state;
    Parameters params;
    SensorWatch watch;
    FaultTable table;
    OwnRows rows;
    std::int64_t tick = -1;
    bool has_state = false;
};

// ------------------------------------------------------------------------------------------------ motion

constexpr double kLostTolerance = 0.05;  // rad; a reference further from the joint is no motion any more

enum TorqueMode { kUnknown = 0, kInactive = 1, kActive = 2, kDegraded = 3, kStopping = 4, kHolding = 5, kStopped = 6 };

class MotionTick {
  public:
    MotionTick(int joints, double dt, RampPlan plan)
        : n(joints),
          dt(dt),
          sample(MotionSample::size(joints), 0.0),
          reference(MotionReference::size(joints), 0.0),
          output(MotionOutput::size(joints), 0.0),
          state(MotionState::size(joints), 0.0),
          params(MotionParams::size(joints), std::move(plan), dt),
          follower(joints, dt),
          slow(dt),
          next_(state.size()) {}

    // Link parameters survive, the reference starts at the measured position.
    void start() {
        std::vector<double> kept(static_cast<std::size_t>(LINK_PARAMETERS * n));
        const double* own = MotionState(state.data(), n).link_parameters;
        std::copy(own, own + LINK_PARAMETERS * n, kept.begin());
        params.arrive();
        std::fill(state.begin(), state.end(), 0.0);
        if (has_state) std::copy(kept.begin(), kept.end(), MotionState(state.data(), n).link_parameters);
        handover.store(nullptr);
        follower.forget();
        slow.reset();
        tick = -1;
    }

    void act(std::int64_t now) {
        const MotionSample in(sample.data(), n);
        if (!follower.set()) follower.hold(in.joint_position, now);
        check_reference(in.joint_position, now);
        if (MotionPath* path = handover.exchange(nullptr, std::memory_order_acq_rel)) take(path, now);
        const bool degraded = mode.load(std::memory_order_relaxed) == kDegraded;
        if (degraded || !slow.at_rest())
            sample_slowly(now, degraded);
        else
            follower.sample(static_cast<double>(now), reference.data());
        if (params.changes()) params.take(has_state ? state.data() : nullptr);
        const MotionParams law(params.now.data(), n);
        if (!has_state) {
            std::fill(state.begin(), state.end(), 0.0);
            std::copy(law.link_parameters, law.link_parameters + LINK_PARAMETERS * n,
                      MotionState(state.data(), n).link_parameters);
            has_state = true;
        }
        motion_step(law, state.data(), in, MotionReference(reference.data(), n), output.data(), next_.data(), n, dt);
        std::copy(next_.begin(), next_.end(), state.begin());
        tick = now;
    }

    const int n;
    const double dt;
    std::vector<double> sample, reference, output, state;
    Parameters params;
    Follower follower;
    SlowMotion slow;
    std::atomic<MotionPath*> handover{nullptr};
    std::atomic<int> mode{kUnknown};
    std::atomic<bool> reset_asked{false};
    std::atomic<int> resets{0};
    std::int64_t tick = -1;
    long late_goals = 0, aborted_goals = 0;
    bool has_state = false;

  private:
    bool stopped() const {
        const int now = mode.load(std::memory_order_relaxed);
        return now == kStopping || now == kHolding || now == kStopped;
    }

    // Drops the goal when a joint does not follow any more, or on a reset: the reference becomes its position.
    void check_reference(const double* measured, std::int64_t now) {
        bool lost = false;
        for (int j = 0; j < n; ++j)
            lost |= std::fabs(reference[static_cast<std::size_t>(j)] - measured[j]) > kLostTolerance;
        lost = lost && tick >= 0;
        const double path_time = static_cast<double>(now) - slow.lag;
        if (stopped() && follower.moving(path_time)) lost = true;
        const bool asked = reset_asked.load(std::memory_order_acquire);
        if (!(lost || asked) || !all_finite(measured, n)) return;
        if (follower.moving(path_time)) ++aborted_goals;
        follower.hold(measured, now);
        slow.reset();
        if (asked) {
            reset_asked.store(false, std::memory_order_relaxed);
            resets.fetch_add(1, std::memory_order_release);
        }
    }

    void take(MotionPath* path, std::int64_t now) {
        if (path->start_tick() < now || !slow.at_rest())  // made for a reference that is not there any more
            ++late_goals;
        else
            follower.accept(path, now);
    }

    // The reference on the path's own time; back at full rate the path itself is put off by what was lost.
    void sample_slowly(std::int64_t now, bool degraded) {
        slow.step(degraded);
        follower.sample(static_cast<double>(now) - slow.lag, reference.data());
        slow.scale(reference.data(), n);
        if (slow.rate == 1.0) {
            follower.delay(slow.lag);
            slow.reset();
        }
    }

    std::vector<double> next_;
};

// ------------------------------------------------------------------------------------------------ torque

constexpr int kWatchTicks = 10;                  // the adaptation is looked at every so many ticks
constexpr int kWarmTicks = 50;                   // in a row since the activation before lateness is a fault
constexpr double kIdleTicks = 200.0;             // of a drive that applies nothing; then the estimates stand, too
constexpr int kSent = 16;                        // commands that are remembered
constexpr double kObeyedShare = 0.05, kObeyedPart = 0.1;  // of the limit and of the torque: reported ones are that exact
constexpr double kReferenceTolerance = 0.005;    // rad; a reference further from the joint refuses a reset

enum class TorqueLaw { adaptive, manifold, feedback };

class TorqueTick {
  public:
    TorqueTick(int joints, double dt, TorqueLaw law, const double* gate_limits, const double* guard_limits,
               const double* bounds, std::size_t before, std::size_t after, RampPlan plan,
               std::vector<double> unseen_inputs)
        : n(joints),
          dt(dt),
          law(law),
          sample(TorqueSample::size(joints), 0.0),
          reference(TorqueReference::size(joints), 0.0),
          output(output_size(law, joints), 0.0),
          state(state_size(law, joints), 0.0),
          adaptation(AdaptationWatch::size(joints), 0.0),
          params(params_size(law, joints), std::move(plan), dt),
          guard(gate_limits, guard_limits, bounds, joints, dt, 0.0),
          table(joints),
          rows(64 * joints + 16),
          ring(2 * (before + 1 + after)),
          allowed(static_cast<std::size_t>(joints), 0.0),
          command(static_cast<std::size_t>(joints), 0.0),
          refusals(static_cast<std::size_t>(4 * (4 * joints + 4))),
          disobeyed(static_cast<std::size_t>(joints), 0.0),
          railed(static_cast<std::size_t>(joints), 0.0),
          input_ticks(unseen_inputs),
          sent_(static_cast<std::size_t>(kSent * joints), 0.0),
          unseen_(std::move(unseen_inputs)),
          ages_(static_cast<std::size_t>(joints), 0.0),
          ticks_(static_cast<std::size_t>(joints), 0.0),
          kept_(static_cast<std::size_t>(5 * joints)) {}

    static std::size_t params_size(TorqueLaw law, int n) {
        return law == TorqueLaw::adaptive ? TorqueParams::size(n)
                                          : (law == TorqueLaw::manifold ? ManifoldParams::size(n) : FeedbackParams::size(n));
    }
    static std::size_t state_size(TorqueLaw law, int n) {
        return law == TorqueLaw::adaptive ? TorqueState::size(n)
                                          : (law == TorqueLaw::manifold ? ManifoldState::size(n) : FeedbackState::size(n));
    }
    static std::size_t output_size(TorqueLaw law, int n) {
        return law == TorqueLaw::adaptive ? TorqueOutput::size(n)
                                          : (law == TorqueLaw::manifold ? ManifoldOutput::size(n) : FeedbackOutput::size(n));
    }

    // A new activation: estimates and a latched stop survive, the filters fill again.
    void start() {
        if (has_state) {
            restart_filters();
            params.go_on();
        } else {
            params.arrive();
        }
        guard.deactivate();
        gate_open = false;
        forget_sent();
        std::fill(adaptation.begin(), adaptation.end(), 0.0);
        input_ticks = unseen_;
        warm = 0;
        tick = -1;
    }

    void act(std::int64_t now) {
        monitor(now);
        const double* wanted = command_of_law();
        if (failed.load(std::memory_order_acquire) && !guard.stopped()) wanted = no_command();
        tick = now;
        gate(wanted, now);
        ring.note(static_cast<double>(now), cause());
    }

    // The same with a command that somebody else has computed: a law in Python.
    void act_with(std::int64_t now, const double* given) {
        monitor(now);
        const double* wanted = given == nullptr || (failed.load() && !guard.stopped()) ? no_command() : checked(given);
        tick = now;
        gate(wanted, now);
        ring.note(static_cast<double>(now), cause());
    }

    // Row of what the latched stop is due to; null while nothing is stopped.
    const double* cause() const {
        if (!guard.stopped()) return nullptr;
        if (failed.load(std::memory_order_relaxed)) return kExceptionRow;
        return table.stop_tick >= 0.0 ? table.stop.data() : kUnknownStop;
    }

    // INACTIVE, ACTIVE, DEGRADED, STOPPING, HOLDING, STOPPED as numbers of TorqueMode.
    int mode() const {
        const int found = guard.mode();
        if (found == 1) return degraded_samples > 0.0 ? kDegraded : kActive;
        return found == 0 ? kInactive : found + 2;
    }

    const int n;
    const double dt;
    const TorqueLaw law;
    std::vector<double> sample, reference, output, state, adaptation;
    Parameters params;
    Guard guard;
    FaultTable table;
    OwnRows rows;
    RowRing ring;
    std::vector<double> allowed, command, refusals;
    std::vector<double> disobeyed;  // ticks in a row in which the drive applied what this law has not sent
    bool compares_applied = true;   // a recording that is played again obeys nobody
    double degraded_samples = 0.0, lost = 0.0, idle = 0.0;
    std::int64_t tick = -1;
    bool has_state = false, gate_open = false;
    std::atomic<bool> failed{false}, reset_asked{false};
    std::atomic<int> resets{0};
    int refused = 0;
    int warm = 0;  // ticks in a row since the activation, up to `kWarmTicks`: nodes lose some while they find each other

  private:
    bool judges_lateness() const { return warm >= kWarmTicks; }

    // Lost ticks, gauge and adaptation; counts how long the robot stays degraded. Rows are what they demand.
    void monitor(std::int64_t now) {
        rows.count = 0;
        const TorqueSample in(sample.data(), n);
        const double gap = tick >= 0 ? static_cast<double>(now - tick - 1) : 0.0;
        if (judges_lateness())
            lost = lost_ticks(gap, lost, guard.limits, guard.guard_limits, rows);
        else
            warm = gap > 0.0 ? 0 : warm + 1, lost = 0.0;
        law_gauge_rail(in.joint_torque, railed.data(), guard.guard_limits, n, rows);
        if (law == TorqueLaw::adaptive && has_state && now % kWatchTicks == 0) watch(in);
        if (compares_applied) obedience(in);
        idle = std::all_of(in.motor_torque, in.motor_torque + n, [](double u) { return u == 0.0; }) ? idle + 1.0 : 0.0;
        if (rows.count > 0 && rows.strongest() >= kDegrade)
            degraded_samples = guard.guard_limits.recover_samples[0];
        else if (degraded_samples > 0.0)
            degraded_samples -= 1.0;
    }

    // F48: a drive that has let go reports zero; one that obeys reports one of our last commands. Anything else is the
    // command of somebody else, or a stop of the drive side.
    void obedience(const TorqueSample& in) {
        for (int j = 0; j < n; ++j) {
            const double u = in.motor_torque[j], limit = guard.limits.torque_limit[j];
            bool ours = u == 0.0 || !std::isfinite(u);
            for (int i = 0; i < kSent; ++i)
                ours |= std::fabs(u - sent_[static_cast<std::size_t>(i * n + j)]) <=
                        kObeyedShare * limit + kObeyedPart * std::fabs(u);
            double& run = disobeyed[static_cast<std::size_t>(j)];
            run = ours ? 0.0 : run + 1.0;
            if (run >= guard.limits.age_limit[0]) rows.add(kNotObeyed, j, u, allowed[static_cast<std::size_t>(j)], kDegrade);
        }
    }

    void forget_sent() {
        std::fill(sent_.begin(), sent_.end(), 0.0);
        std::fill(disobeyed.begin(), disobeyed.end(), 0.0);
        sends_ = 0;
        idle = 0.0;
    }

    void watch(const TorqueSample& in) {
        const TorqueState s(state.data(), n);
        const TorqueParams p(params.now.data(), n);
        const double* own[5] = {s.coulomb_torque, s.friction_offset, s.viscous_positive, s.viscous_negative,
                                s.torsional_compliance};
        const double* low[5] = {p.coulomb_torque_low, p.friction_offset_low, p.viscous_low, p.viscous_low,
                                p.torsional_compliance_low};
        const double* high[5] = {p.coulomb_torque_high, p.friction_offset_high, p.viscous_high, p.viscous_high,
                                 p.torsional_compliance_high};
        AdaptationWatch memory(adaptation.data(), n);
        watch_adaptation(memory, own, low, high, 5, TorqueReference(reference.data(), n).desired_position,
                         in.joint_position, guard.guard_limits, n, kWatchTicks * dt, rows);
    }

    // The law's step. Degraded, the estimates stay as they were, bit for bit; and so behind brakes that stay closed,
    // where an error that no torque can move would wind them up.
    const double* command_of_law() {
        const bool had = has_state;
        const bool keep = (degraded_samples > 0.0 || idle > kIdleTicks) && had && law == TorqueLaw::adaptive;
        if (keep) estimates(true);
        if (params.changes()) params.take(has_state ? state.data() : nullptr);
        if (!has_state) first_state();
        std::fill(output.begin(), output.end(), 0.0);
        const TorqueSample in(sample.data(), n);
        const TorqueReference want(reference.data(), n);
        const double* torque = nullptr;
        if (law == TorqueLaw::adaptive) {
            TorqueState memory(state.data(), n);
            TorqueOutput out(output.data(), n);
            torque_step(TorqueParams(params.now.data(), n), memory, in, want, out, n, dt);
            torque = out.motor_torque;
        } else if (law == TorqueLaw::manifold) {
            ManifoldState memory(state.data(), n);
            ManifoldOutput out(output.data(), n);
            manifold_chain_step(ManifoldParams(params.now.data(), n), memory, in, want, out, n, dt);
            torque = out.motor_torque;
        } else {
            FeedbackState memory(state.data(), n);
            FeedbackOutput out(output.data(), n);
            feedback_chain_step(FeedbackParams(params.now.data(), n), memory, in, want, out, n, dt);
            torque = out.motor_torque;
        }
        if (keep) estimates(false);
        return checked(torque);
    }

    void estimates(bool save) {
        TorqueState s(state.data(), n);
        double* own[5] = {s.coulomb_torque, s.friction_offset, s.viscous_positive, s.viscous_negative,
                          s.torsional_compliance};
        for (int i = 0; i < 5; ++i) {
            double* kept = kept_.data() + i * n;
            if (save)
                std::copy(own[i], own[i] + n, kept);
            else
                std::copy(kept, kept + n, own[i]);
        }
    }

    // Estimates at their start values; the filters fill with the first sample.
    void first_state() {
        std::fill(state.begin(), state.end(), 0.0);
        if (law == TorqueLaw::adaptive) {
            TorqueState s(state.data(), n);
            const TorqueParams p(params.now.data(), n);
            const double* starts[5] = {p.coulomb_torque_initial, p.friction_offset_initial, p.viscous_positive_initial,
                                       p.viscous_negative_initial, p.torsional_compliance_initial};
            double* own[5] = {s.coulomb_torque, s.friction_offset, s.viscous_positive, s.viscous_negative,
                              s.torsional_compliance};
            for (int i = 0; i < 5; ++i) std::copy(starts[i], starts[i] + n, own[i]);
        }
        has_state = true;
    }

    // Not a number for joints with an input that is not finite, which a law might clip.
    const double* checked(const double* torque) {
        const TorqueSample in(sample.data(), n);
        const int used = static_cast<int>(in.motor_torque - sample.data());
        const int wanted = static_cast<int>(reference.size());
        std::copy(torque, torque + n, command.begin());
        if (all_finite(sample.data(), used) && all_finite(reference.data(), wanted)) return command.data();
        for (int j = 0; j < n; ++j) {
            bool finite = true;
            for (int i = j; i < used; i += n) finite &= std::isfinite(sample[static_cast<std::size_t>(i)]);
            for (int i = j; i < wanted; i += n) finite &= std::isfinite(reference[static_cast<std::size_t>(i)]);
            if (!finite) command[static_cast<std::size_t>(j)] = NAN;
        }
        return command.data();
    }

    const double* no_command() {
        std::fill(command.begin(), command.end(), NAN);
        return command.data();
    }

    // The last step before publishing. The gate opens with the torque that the drive holds.
    void gate(const double* wanted, std::int64_t now) {
        const TorqueSample in(sample.data(), n);
        if (!gate_open) {
            guard.activate(in.motor_torque);
            gate_open = true;
        }
        std::fill(ticks_.begin(), ticks_.end(), static_cast<double>(now));
        std::fill(ages_.begin(), ages_.end(), input_age(static_cast<double>(now)));
        std::copy(in.motor_position, in.motor_position + n, guard.seen.motor_position);
        std::copy(in.motor_velocity, in.motor_velocity + n, guard.seen.motor_velocity);
        std::copy(in.joint_position, in.joint_position + n, guard.seen.joint_position);
        std::copy(in.joint_velocity, in.joint_velocity + n, guard.seen.joint_velocity);
        if (reset_asked.load(std::memory_order_acquire)) answer_reset();
        guard.step(wanted, ages_.data(), ticks_.data(), allowed.data(), rows);
        std::copy(allowed.begin(), allowed.end(), sent_.begin() + static_cast<std::ptrdiff_t>(sends_ * n));
        sends_ = (sends_ + 1) % kSent;
        if (rows.count > 0) table.note(rows, static_cast<double>(now));
    }

    // Samples since the oldest input was there, 0 while lateness is not judged; negative if one is ahead of this tick,
    // which is the first to be said.
    double input_age(double now) const {
        double oldest = 0.0;
        for (const double seen : input_ticks) {
            if (now < seen) return now - seen;
            if (now - seen > oldest) oldest = now - seen;
        }
        return judges_lateness() ? oldest : 0.0;
    }

    // Between two ticks, on request of the reset service.
    void answer_reset() {
        const TorqueSample in(sample.data(), n);
        const TorqueReference want(reference.data(), n);
        const int own = 2 * n + 1;  // rows of the guard come first
        double* other = refusals.data() + 4 * own;
        int others = 0;
        for (int j = 0; j < n; ++j) {
            auto refuse = [&](int kind, double value, double limit) {
                double* row = other + 4 * others++;
                row[0] = kind, row[1] = j, row[2] = value, row[3] = limit;
            };
            if (!(want.desired_velocity[j] == 0.0)) refuse(kGoalActive, want.desired_velocity[j], 0.0);
            const double away = want.desired_position[j] - in.joint_position[j];
            if (!(std::fabs(away) <= kReferenceTolerance)) refuse(kReferenceAway, away, kReferenceTolerance);
        }
        const bool was_stopped = guard.stopped();
        const int mine = guard.reset(refusals.data(), others > 0);
        if (was_stopped) {
            std::memmove(refusals.data() + 4 * mine, other, sizeof(double) * static_cast<std::size_t>(4 * others));
            refused = mine + others;
        } else {
            refused = 0;
        }
        if (refused == 0) {
            failed.store(false, std::memory_order_relaxed);
            table.clear();
            if (has_state) restart_filters();
        }
        reset_asked.store(false, std::memory_order_relaxed);
        resets.fetch_add(1, std::memory_order_release);
    }

  public:
    // Estimates kept, filters filled anew with the next sample (bumpless restart).
    void restart_filters() {
        double* started = law == TorqueLaw::adaptive
                              ? TorqueState(state.data(), n).started
                              : (law == TorqueLaw::manifold ? ManifoldState(state.data(), n).started
                                                            : FeedbackState(state.data(), n).started);
        std::fill(started, started + n, 0.0);
    }

    std::vector<double> railed;
    // Tick of the message that filled each input, in the order of the wiring. Before the first: -1, or not a number for
    // an input that counts only once it has been seen.
    std::vector<double> input_ticks;

  private:
    std::vector<double> sent_, unseen_, ages_, ticks_, kept_;
    int sends_ = 0;
};

}  // namespace hd
