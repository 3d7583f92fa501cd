// The loop that sets the tick: of a plant, or of whatever stands in front of drives.
//
// Tick k: the command of tick k-1 is latched, the sensors are sampled and published with stamp k * dt, then [k, k+1) is
// integrated: in lock-step at once, on the wall clock when the command of tick k is there, so that the chain need not
// wait for it. In lock-step tick k+1 waits for the complete command of tick k.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "plane.hpp"

namespace hd {

// Steady and system clock. A test may set both; then sleeping moves the steady one.
struct Clock {
    std::atomic<bool> pretended{false};
    std::atomic<std::int64_t> steady{0}, system{0};  // ns; `system` is an offset to the steady one

    std::int64_t steady_now() const { return pretended.load() ? steady.load() : steady_ns(); }
    std::int64_t system_now() const {
        return pretended.load() ? steady.load() + system.load() : clock_ns(CLOCK_REALTIME);
    }
};

// Commands of each joint in memory of their own, for a drive side without a table.
struct CommandTable {
    explicit CommandTable(std::size_t joints) : torque(joints, 0.0), tick(joints, -1) {}

    std::vector<double> torque;      // N m
    std::vector<std::int64_t> tick;  // -1: never
    std::int64_t stale = 0;          // commands that were not newer
    std::int64_t strangers = 0;      // commands of another publisher
    bool stands = false;             // another publisher may take over

    Commands commands() {
        return {this, &offer, [](void* table, int joint) { return of(table).tick[static_cast<std::size_t>(joint)]; },
                [](void* table) { return of(table).stands; }, [](void* table) { ++of(table).strangers; }};
    }

  private:
    static CommandTable& of(void* table) { return *static_cast<CommandTable*>(table); }
    static bool offer(void* table, const int* joints, int count, const double* torque, std::int64_t tick) {
        CommandTable& own = of(table);
        for (int i = 0; i < count; ++i) {
            if (own.tick[static_cast<std::size_t>(joints[i])] >= tick) {
                ++own.stale;
                return false;
            }
        }
        for (int i = 0; i < count; ++i) {
            own.torque[static_cast<std::size_t>(joints[i])] = torque[i];
            own.tick[static_cast<std::size_t>(joints[i])] = tick;
        }
        return true;
    }
};

// Commands from one publisher or several, merged by joint name. The first publisher of a joint is bound by its run id;
// another one is foreign, which the drive side hears of. A bound publisher is replaced only while the robot stands.
class CommandInput {
  public:
    CommandInput(std::vector<std::string> joints, std::int64_t dt_ns, Commands commands,
                 std::atomic<std::int64_t>& foreign)
        : joints_(std::move(joints)), dt_ns_(dt_ns), commands_(commands), foreign_(foreign) {}

    void offer(std::string_view data) {
        Source* source = find(data);
        if (source != nullptr) return;
        Statistics::add(foreign_, 1);
        if (commands_.stranger != nullptr) commands_.stranger(commands_.context);
    }
    void release() { sources_.clear(); }

    std::atomic<std::int64_t> unreadable{0};  // of those that are foreign: no layout that could be bound

  private:
    struct Source {
        Source(std::vector<int> places, std::int64_t dt_ns)
            : joints(std::move(places)), torque(joints.size()), join(dt_ns) {}
        std::vector<int> joints;
        std::vector<double> torque;
        Join join;
    };
    bool stands() const { return commands_.stands(commands_.context); }
    void hand_on(const Source& source) {
        commands_.offer(commands_.context, source.joints.data(), static_cast<int>(source.joints.size()),
                        source.torque.data(), source.join.tick);
    }

    Source* find(std::string_view data) {
        for (std::size_t i = 0; i < sources_.size(); ++i) {
            Source& source = *sources_[i];
            const Offer outcome = source.join.offer(0, data);
            if (outcome == kComplete || outcome == kStale || outcome == kRepeated) {
                hand_on(source);
                return &source;
            }
            if (outcome == kAhead) {  // the drive side drops it, too, and reports by how much
                commands_.offer(commands_.context, source.joints.data(), static_cast<int>(source.joints.size()),
                                source.torque.data(), source.join.inputs.front().leap);
                return &source;
            }
            if (outcome == kForeign) {
                if (!stands()) return nullptr;
                sources_.erase(sources_.begin() + static_cast<std::ptrdiff_t>(i));
                break;
            }
        }
        return bind(data);
    }

    // A new publisher, unless its layout is unusable or one of its joints has a publisher already.
    Source* bind(std::string_view data) {
        JointStateParts parts;
        if (!parts.read(data) || parts.swapped || parts.frame.empty() || parts.names == 0) return unusable();
        std::vector<int> places;
        parts.each_name(data, [&](std::size_t, std::string_view name) {
            const auto found = std::find(joints_.begin(), joints_.end(), name);
            places.push_back(static_cast<int>(found - joints_.begin()));
        });
        if (!usable(parts, places)) return unusable();
        const auto shared = [&](const std::unique_ptr<Source>& other) {
            return std::any_of(places.begin(), places.end(), [&](int joint) {
                return std::find(other->joints.begin(), other->joints.end(), joint) != other->joints.end();
            });
        };
        if (std::any_of(sources_.begin(), sources_.end(), shared) && !stands()) return nullptr;
        auto source = std::make_unique<Source>(places, dt_ns_);
        Input input;
        input.layout = parts.layout(data);
        for (std::size_t i = 0; i < places.size(); ++i) {
            input.copies.push_back({parts.numbers[kEffort].at + 8 * i, source->torque.data() + i});
        }
        source->join.inputs.push_back(std::move(input));
        if (source->join.offer(0, data) != kComplete) return nullptr;
        sources_.erase(std::remove_if(sources_.begin(), sources_.end(), shared), sources_.end());
        sources_.push_back(std::move(source));
        hand_on(*sources_.back());
        return sources_.back().get();
    }

    Source* unusable() {
        Statistics::add(unreadable, 1);
        return nullptr;
    }

    bool usable(const JointStateParts& parts, std::vector<int> places) const {
        const auto unknown = static_cast<int>(joints_.size());
        if (std::find(places.begin(), places.end(), unknown) != places.end()) return false;
        std::sort(places.begin(), places.end());
        if (std::adjacent_find(places.begin(), places.end()) != places.end()) return false;
        for (const Numbers& numbers : parts.numbers) {
            if (numbers.count != 0 && numbers.count != parts.names) return false;
        }
        return parts.numbers[kEffort].count == parts.names;
    }

    static constexpr std::size_t kEffort = 2;
    std::vector<std::string> joints_;
    std::int64_t dt_ns_;
    Commands commands_;
    std::atomic<std::int64_t>& foreign_;
    std::vector<std::unique_ptr<Source>> sources_;
};

struct TimedSettings {
    bool lockstep = false;
    std::int64_t recorder_lag = 0;  // ticks that a recorder may lag in lock-step; 0: none is waited for
    std::int64_t temperature_ticks = 100;
};

// What may change while it runs; from any thread.
struct TimedValues {
    std::atomic<std::int64_t> pause_at{-1}, stop_after{0}, timeout_ns{10000000000};
};

// Why a lock-step plant went on without an answer; the words are made in Python.
struct TimedFault {
    enum Kind { kNone = 0, kNoCommand = 1, kRecorderBehind = 2 };
    std::atomic<int> kind{kNone};
    std::atomic<std::int64_t> tick{0}, limit_ns{0}, recorded{0};
    std::atomic<std::uint64_t> missing{0};  // a bit for each joint
};

// A step that hands on a command of the same process.
struct OwnCommand {
    Commands commands;
    const double* torque;
    std::vector<int> joints;

    static void run(void* context, std::int64_t tick) {
        const auto* own = static_cast<OwnCommand*>(context);
        const Commands& to = own->commands;
        to.offer(to.context, own->joints.data(), static_cast<int>(own->joints.size()), own->torque, tick);
    }
};

class TimedLoop : public Loop {
  public:
    static constexpr std::int64_t kImpatient =
        20000000;  // ns per tick once a command was missing for the whole timeout
    static constexpr std::int64_t kAskAgain = 200000000;  // ns; a message may be lost while nodes find each other
    static constexpr std::int64_t kStartLead = 20;        // ticks
    static constexpr std::int64_t kProgressEvery = 50;    // ticks

    TimedLoop(std::int64_t dt_ns, TimedSettings settings, int joints, Commands commands)
        : Loop(dt_ns, false), joints(joints), commands(commands), settings_(settings) {
        reset();
    }

    // Messages with commands; without them a step of `send` hands commands on.
    void listen(Inbox& inbox, CommandInput& input) { inbox_ = &inbox, input_ = &input; }
    void follow_recorder(Inbox& recorder) { recorder_ = &recorder; }
    void report_progress(Outbox& outbox) { progress_ = &outbox; }

    // A new activation. Lock-step counts on from where it was, from 0 the first time; wall time starts anew.
    void start() {
        between([this] {
            reset();
            active.store(true);
        });
    }
    void stop() {
        between([this] { active.store(false); });
    }
    void release() {
        between([this] {
            if (input_ != nullptr) input_->release();
        });
    }
    std::int64_t tick() const { return tick_.load(); }
    std::int64_t skipped() const { return skipped_.load(); }
    // Ticks of the wall clock whose command was not there at the next deadline.
    std::int64_t late() const { return late_.load(); }

    const int joints;
    const Commands commands;
    TimedValues values;
    TimedFault fault;
    Clock clock;
    Step measure{nullptr, [](void*, std::int64_t) {}}, advance = measure;
    Program temperature, send;

  protected:
    Pause turn() override {
        collect();
        if (!active.load()) return rest();
        return settings_.lockstep ? lockstep_turn() : wall_turn();
    }
    void sleep(std::uint32_t seen, const Pause& pause) override {
        if (clock.pretended.load()) {
            clock.steady.store(std::max(clock.steady.load(), pause.until_ns));
        } else {
            Loop::sleep(seen, pause);
        }
    }

  private:
    void reset() {
        if (!settings_.lockstep) tick_.store(0);
        first_tick_ = tick_.load();
        deadline_ = published_ = measured_ = reported_ = -1;
        waiting_since_ = ask_again_ = 0;
        impatient_ = false;
        answered_ = true;
        skipped_.store(0), late_.store(0);
        fault.kind.store(TimedFault::kNone);
    }

    Pause rest() const { return {clock.steady_now() + kLongestSleep, false}; }

    void collect() {
        while (inbox_ != nullptr && inbox_->take()) input_->offer(inbox_->message());
    }

    // True while the plant stands still on purpose.
    bool halted() {
        const std::int64_t tick = tick_.load(), pause_at = values.pause_at.load(),
                           stop_after = values.stop_after.load();
        const bool paused = settings_.lockstep && pause_at >= 0 && pause_at <= tick;
        const bool finished = stop_after > 0 && stop_after <= tick - first_tick_;
        if (!paused && !finished) return false;
        if (reported_ != tick) report(reported_ = tick);
        return true;
    }

    void report(std::int64_t tick) {
        if (progress_ != nullptr) progress_->send_number(4, static_cast<std::uint64_t>(tick));
    }

    bool complete(std::int64_t tick) const {
        for (int j = 0; j < joints; ++j) {
            if (commands.tick_of(commands.context, j) < tick) return false;
        }
        return true;
    }

    bool failed() const { return failure.raised.load(); }

    void measure_now(std::int64_t tick) {
        measure(tick);
        measured_ = tick;
    }

    void publish(std::int64_t tick) {
        const std::int64_t stamp_ns = tick * dt_ns;
        if (tick % settings_.temperature_ticks == 0) temperature.run(tick, stamp_ns, failure);
        if (!failed()) send.run(tick, stamp_ns, failure);
        published_ = tick;
    }

    void finish(std::int64_t tick) {
        statistics.tick(tick, waiting_since_, clock.steady_now());
        tick_.store(tick + 1);
        if ((tick + 1) % kProgressEvery == 0) report(tick + 1);
    }

    // Lock-step -------------------------------------------------------------------------------------------------------

    Pause lockstep_turn() {
        const std::int64_t tick = tick_.load();
        if (published_ < tick) {
            if (halted()) return rest();
            if (recorder_behind(tick)) return {clock.steady_now() + 1000000, false};
            measure_now(tick);
            if (!failed()) publish(tick);
            if (!failed()) advance(tick);
            if (failed()) return {};
            waiting_since_ = clock.steady_now();
            ask_again_ = waiting_since_ + kAskAgain;
        }
        const std::int64_t now = clock.steady_now();
        if (complete(tick)) {
            impatient_ = false;
            statistics.answer(now - waiting_since_);
            finish(tick);
            return {};
        }
        const std::int64_t limit = impatient_ ? kImpatient : values.timeout_ns.load();
        if (now < waiting_since_ + limit) {
            if (now > ask_again_) {
                ask_again_ += kAskAgain;
                send.run(tick, tick * dt_ns, failure);
            }
            return {std::min({waiting_since_ + limit, ask_again_ + 1, now + kLongestSleep}), false};
        }
        if (!impatient_) note_no_command(tick, limit);
        impatient_ = true;
        finish(tick);
        return {};
    }

    void note_no_command(std::int64_t tick, std::int64_t limit) {
        std::uint64_t missing = 0;
        for (int j = 0; j < joints && j < 64; ++j) {
            if (commands.tick_of(commands.context, j) < tick) missing |= std::uint64_t{1} << j;
        }
        fault.tick.store(tick), fault.limit_ns.store(limit), fault.missing.store(missing);
        fault.kind.store(TimedFault::kNoCommand);
    }

    bool recorder_behind(std::int64_t tick) {
        const std::int64_t recorded = settings_.recorder_lag > 0 ? newest_recorded() : 0;
        const bool in_time = recorded >= 0 && tick - std::max(recorded, first_tick_) <= settings_.recorder_lag;
        if (settings_.recorder_lag == 0 || in_time) {
            behind_since_ = 0;
            return false;
        }
        const std::int64_t now = clock.steady_now();
        if (behind_since_ == 0) behind_since_ = now;
        if (now - behind_since_ > values.timeout_ns.load()) {
            fault.recorded.store(recorded), fault.tick.store(tick), fault.kind.store(TimedFault::kRecorderBehind);
            settings_.recorder_lag = 0;
        }
        return true;
    }

    std::int64_t newest_recorded() {
        while (recorder_ != nullptr && recorder_->take()) {
            const std::string_view data = recorder_->message();
            if (data.size() < 12) continue;
            std::uint64_t tick = 0;
            std::memcpy(&tick, data.data() + 4, sizeof tick);
            recorded_ = static_cast<std::int64_t>(tick);
        }
        return recorded_;
    }

    // Wall clock ------------------------------------------------------------------------------------------------------

    Pause wall_turn() {
        if (halted()) {
            deadline_ = -1;
            return rest();
        }
        if (deadline_ < 0) set_out();
        std::int64_t tick = tick_.load(), now = clock.steady_now();
        if (now < deadline_ && measured_ != tick && !command_there(tick - 1, now)) return {deadline_, false};
        if (measured_ != tick) prepare(tick);
        if (failed()) return {};
        if (clock.steady_now() < deadline_) return {deadline_, true};
        while (clock.steady_now() >= deadline_ + dt_ns) {  // overslept: a gap that everybody can see
            skipped_.fetch_add(1);
            tick_.store(++tick);
            deadline_ += dt_ns;
            prepare(tick);
            if (failed()) return {};
        }
        if (!answered_) late_.fetch_add(1);
        waiting_since_ = clock.steady_now();
        answered_ = false;
        publish(tick);
        deadline_ += dt_ns;
        finish(tick);
        return {};
    }

    bool command_there(std::int64_t tick, std::int64_t now) {
        if (!complete(tick)) return false;
        if (!answered_) statistics.answer(now - waiting_since_);
        answered_ = true;
        return true;
    }

    // Integrates up to the tick, latches the newest command for it and reads the sensors: all but the publishing. It is
    // done once the command is there, or at the deadline without it, so that nothing but publishing stands between the
    // deadline and the control chain.
    void prepare(std::int64_t tick) {
        if (measured_ >= first_tick_) advance(tick);
        if (failed()) return;
        collect();
        measure_now(tick);
    }

    // Binds tick numbers to the wall clock and deadlines to the steady clock, once per activation.
    void set_out() {
        const std::int64_t now = clock.steady_now(), wall = clock.system_now();
        tick_.store(wall / dt_ns + kStartLead);
        first_tick_ = tick_.load();
        measured_ = -1;
        deadline_ = now + first_tick_ * dt_ns - wall;
    }

    TimedSettings settings_;
    Inbox *inbox_ = nullptr, *recorder_ = nullptr;
    CommandInput* input_ = nullptr;
    Outbox* progress_ = nullptr;
    std::atomic<std::int64_t> tick_{0}, skipped_{0}, late_{0};
    std::int64_t first_tick_ = 0, deadline_ = -1, published_ = -1, measured_ = -1, reported_ = -1;
    std::int64_t waiting_since_ = 0, ask_again_ = 0, behind_since_ = 0, recorded_ = -1;
    bool impatient_ = false, answered_ = true;
};

}  // namespace hd
