// The data plane of one loop: take, join by tick, step, publish, count, in one thread that never asks for the
// interpreter. Python makes it, switches it on and off, and reads its counters (hd_control/nodes/fast_loop.py).
//
// How the thread wakes: the middleware's receiving thread counts a message and rings a bell, which is an atomic number
// with a futex behind it; it takes no lock (rcl_access.hpp says why that matters). Where such callbacks were not proven
// harmless the loop looks every 100 us instead. How others get in: `between_` is held while the loop works and free
// while it sleeps, so whoever holds it stands between two ticks. Nobody holds it while waiting for the interpreter or
// for the middleware, but the loop itself.
#pragma once

#include <linux/futex.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <utility>
#include <variant>
#include <vector>

#include "joint_state.hpp"
#include "message_join.hpp"
#include "rcl_access.hpp"
#include "step.hpp"

namespace hd {

inline std::int64_t clock_ns(clockid_t clock) {
    timespec now{};
    clock_gettime(clock, &now);
    return static_cast<std::int64_t>(now.tv_sec) * 1000000000 + now.tv_nsec;
}
inline std::int64_t steady_ns() { return clock_ns(CLOCK_MONOTONIC); }

constexpr std::int64_t kLongestSleep = 100000000;  // ns; a loop looks around this often, whatever was announced
constexpr std::int64_t kLookEvery = 100000;        // ns, where no new-message callback may be set

// A number that any thread may raise and one thread sleeps on. Ringing takes no lock.
class Bell {
  public:
    void ring() {
        count_.fetch_add(1);
        if (asleep_.load()) futex(FUTEX_WAKE_PRIVATE, 1, nullptr);
    }
    std::uint32_t count() const { return count_.load(); }

    // Sleeps until the count is not `seen` any more or the steady clock reaches `until_ns`.
    void sleep(std::uint32_t seen, std::int64_t until_ns) {
        const timespec until{static_cast<time_t>(until_ns / 1000000000), static_cast<long>(until_ns % 1000000000)};
        asleep_.store(true);
        if (count_.load() == seen) futex(FUTEX_WAIT_BITSET_PRIVATE, seen, &until);
        asleep_.store(false);
    }

  private:
    void futex(int operation, std::uint32_t value, const timespec* until) {
        static_assert(sizeof(count_) == sizeof(std::uint32_t));
        syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&count_), operation, value, until, nullptr,
                FUTEX_BITSET_MATCH_ANY);
    }
    std::atomic<std::uint32_t> count_{0};
    std::atomic<bool> asleep_{false};
};

// One subscription. Its messages are counted as they arrive and taken by the loop alone.
class Inbox {
  public:
    Inbox(const void* subscription, std::size_t capacity, Bell& bell)
        : calls_(rcl::calls()), subscription_(subscription), buffer_(capacity), bell_(bell) {}
    Inbox(const Inbox&) = delete;
    Inbox& operator=(const Inbox&) = delete;

    // Callbacks are set once and removed once in the life of a subscription.
    bool listen() {
        listening_ =
            rcl::callbacks_are_safe(calls_) && calls_.on_new_message(subscription_, &arrived, this) == rcl::kOk;
        return listening_;
    }
    void close() {
        if (listening_) calls_.on_new_message(subscription_, nullptr, nullptr);
        listening_ = false;
    }
    bool take() { return rcl::take(calls_, subscription_, buffer_); }
    std::string_view message() const { return buffer_.view(); }

    // Shall an arrival wake the loop? To be asked before `waiting`: an arrival between the two rings or is seen.
    void wake(bool wanted) { wakes_.store(wanted); }
    bool waiting() const { return arrivals_.load() != looked_; }
    std::uint32_t arrivals() const { return arrivals_.load(); }
    void looked(std::uint32_t arrivals) { looked_ = arrivals; }
    void look_again() { looked_ = arrivals_.load() - 1; }

  private:
    static void arrived(const void* owner, std::size_t) {
        auto* inbox = const_cast<Inbox*>(static_cast<const Inbox*>(owner));
        inbox->arrivals_.fetch_add(1);
        if (inbox->wakes_.load()) inbox->bell_.ring();
    }
    const rcl::Calls& calls_;
    const void* subscription_;
    rcl::Buffer buffer_;
    Bell& bell_;
    bool listening_ = false;
    std::uint32_t looked_ = UINT32_MAX;  // "one has arrived": before the first look nobody has counted
    std::atomic<std::uint32_t> arrivals_{0};
    std::atomic<bool> wakes_{true};
};

// A message made once: only its stamp and its numbers change.
struct Outgoing {
    struct Run {  // doubles in a row
        std::size_t to;
        const double* from;
        std::size_t count;
    };
    static constexpr std::size_t kNoStamp = SIZE_MAX;

    std::string bytes;
    std::size_t stamp_at = kNoStamp;
    std::vector<Run> runs;

    const std::string& fill(std::int64_t stamp_ns) {
        if (stamp_at != kNoStamp) put_stamp(bytes, stamp_at, stamp_ns);
        for (const Run& run : runs) std::memcpy(bytes.data() + run.to, run.from, run.count * sizeof(double));
        return bytes;
    }
};

// One publisher with its message; `on` switches it from any thread.
class Outbox {
  public:
    Outbox(const void* publisher, Outgoing message)
        : calls_(rcl::calls()), publisher_(publisher), message_(std::move(message)) {}

    void send(std::int64_t stamp_ns) {
        if (on.load(std::memory_order_relaxed)) publish(message_.fill(stamp_ns));
    }
    void send_number(std::size_t at, std::uint64_t number) {
        std::memcpy(message_.bytes.data() + at, &number, sizeof number);
        publish(message_.bytes);
    }
    void publish(const std::string& bytes) { rcl::publish(calls_, publisher_, bytes); }

    std::atomic<bool> on{true};

  private:
    const rcl::Calls& calls_;
    const void* publisher_;
    Outgoing message_;
};

// A text that is published when its number changes: the mode of a law.
struct Announcement {
    Outbox* outbox;
    Reading reading;
    std::vector<std::string> messages;  // by number
    std::int64_t last = -1;

    void look() {
        const std::int64_t number = reading.read(reading.context);
        if (number == last) return;
        last = number;
        if (number >= 0 && static_cast<std::size_t>(number) < messages.size()) {
            outbox->publish(messages[static_cast<std::size_t>(number)]);
        }
    }
};

struct CopyNumbers {
    const double* from;
    double* to;
    std::size_t count;
};

// What an error in a step leaves: the loop ends, and whoever runs it raises the error again.
struct Failure {
    std::atomic<bool> raised{false};
    std::exception_ptr what;
};

// What is done in each tick, in order.
struct Program {
    std::vector<std::variant<CopyNumbers, Step, Outbox*, Announcement*>> parts;

    void run(std::int64_t tick, std::int64_t stamp_ns, const Failure& failure) {
        for (auto& part : parts) {
            if (auto* outbox = std::get_if<Outbox*>(&part)) {
                (*outbox)->send(stamp_ns);
            } else if (auto* step = std::get_if<Step>(&part)) {
                (*step)(tick);
                if (failure.raised.load(std::memory_order_relaxed)) return;
            } else if (auto* copy = std::get_if<CopyNumbers>(&part)) {
                std::memcpy(copy->to, copy->from, copy->count * sizeof(double));
            } else {
                std::get<Announcement*>(part)->look();
            }
        }
    }
};

// Counters and rings of the last ticks. One thread writes; a torn reading costs one sample of a percentile, never a
// wrong counter.
class Statistics {
  public:
    static constexpr std::size_t kRing = 1024;                  // ticks that percentiles are taken over
    static constexpr std::int64_t kPlausibleAge = 10000000000;  // ns; lock-step stamps are no wall time
    using Ring = std::array<std::atomic<std::int64_t>, kRing>;

    void tick(std::int64_t number, std::int64_t started_ns, std::int64_t finished_ns) {
        const std::int64_t last = last_tick.load(kAny), count = ticks.load(kAny);
        if (count > 0 && number > last + 1) add(missed, number - last - 1);
        last_tick.store(number, kAny);
        const std::size_t slot = static_cast<std::size_t>(count) % kRing;
        times[slot].store(started_ns, kAny);
        busy[slot].store(finished_ns - started_ns, kAny);
        ticks.store(count + 1, kAny);
    }
    void answer(std::int64_t waited_ns) {
        const std::int64_t count = answers_given.load(kAny);
        answers[static_cast<std::size_t>(count) % kRing].store(waited_ns, kAny);
        answers_given.store(count + 1, kAny);
    }
    void age(std::int64_t stamp_ns) {
        const std::int64_t found = clock_ns(CLOCK_REALTIME) - stamp_ns;
        if (found > oldest_ns.load(kAny) && found < kPlausibleAge) oldest_ns.store(found, kAny);
    }
    void clear() {
        for (auto* each : {&ticks, &missed, &incomplete, &ahead, &oldest_ns}) each->store(0, kAny);
    }
    // p50, p99 and maximum of the newest numbers of a ring in us; false if there are none. `differences`: of each
    // number to the one before it.
    bool spread(const Ring& ring, std::int64_t written, bool differences, std::array<double, 3>& found) const {
        const auto count = static_cast<std::size_t>(std::min<std::int64_t>(written, kRing));
        std::vector<std::int64_t> values(count);
        const std::size_t first = static_cast<std::size_t>(written) - count;
        for (std::size_t i = 0; i < count; ++i) values[i] = ring[(first + i) % kRing].load(kAny);
        if (differences) {
            for (std::size_t i = 0; i + 1 < count; ++i) values[i] = values[i + 1] - values[i];
            if (count > 0) values.pop_back();
        }
        if (values.empty()) return false;
        std::sort(values.begin(), values.end());
        const auto last = static_cast<double>(values.size() - 1);
        constexpr std::array<double, 3> kShares{0.5, 0.99, 1.0};
        for (std::size_t i = 0; i < kShares.size(); ++i) {
            found[i] =
                static_cast<double>(values[static_cast<std::size_t>(std::nearbyint(kShares[i] * last))]) / 1000.0;
        }
        return true;
    }
    static void add(std::atomic<std::int64_t>& counter, std::int64_t more) { counter.fetch_add(more, kAny); }

    static constexpr std::memory_order kAny = std::memory_order_relaxed;
    std::atomic<std::int64_t> ticks{0}, missed{0}, incomplete{0}, foreign{0}, ahead{0}, last_tick{0}, oldest_ns{0};
    std::atomic<std::int64_t> answers_given{0};
    Ring times{}, busy{}, answers{};
};

// What all loops share: being run by one thread, stopped by another, and entered between two ticks.
class Loop {
  public:
    // `poll`: messages are looked for every `kLookEvery`, as where no callback may be set.
    Loop(std::int64_t dt_ns, bool poll) : dt_ns(dt_ns), polled_(poll) {}
    Loop(const Loop&) = delete;
    Loop& operator=(const Loop&) = delete;
    virtual ~Loop() = default;

    // Turns until `interrupt`; to be called by one thread at a time. An error of a step ends it and is thrown here.
    void run() {
        while (!interrupted_.load()) {
            const std::uint32_t seen = bell.count();
            Pause pause;
            let_in();
            {
                const std::lock_guard<std::mutex> lock(between_);
                if (closed_.load()) return;
                pause = turn();
            }
            if (failure.raised.load()) {
                failure.raised.store(false);
                std::rethrow_exception(std::exchange(failure.what, nullptr));
            }
            if (pause.until_ns > 0) sleep(seen, pause);
        }
    }
    void interrupt() {
        interrupted_.store(true);
        bell.ring();
    }
    void rearm() { interrupted_.store(closed_.load()); }

    // Runs `change` between two ticks; when it returns the loop has seen it.
    template <typename Change>
    void between(Change&& change) {
        wanting_.fetch_add(1);
        const std::lock_guard<std::mutex> lock(between_);
        wanting_.fetch_sub(1);
        change();
        bell.ring();
    }

    Inbox& add_inbox(const void* subscription, std::size_t capacity) {
        inboxes_.push_back(std::make_unique<Inbox>(subscription, capacity, bell));
        if (!polled_ && !inboxes_.back()->listen()) polled_ = true;
        return *inboxes_.back();
    }
    // The end: no callback comes any more, no entity of rcl is touched any more.
    void close() {
        closed_ = true;
        interrupt();
        for (auto& inbox : inboxes_) inbox->close();
        const std::lock_guard<std::mutex> lock(between_);
        inboxes_.clear();
    }
    bool polled() const { return polled_; }

    const std::int64_t dt_ns;
    Bell bell;
    Statistics statistics;
    Failure failure;
    std::atomic<bool> active{false};

  protected:
    struct Pause {
        std::int64_t until_ns = 0;  // 0: none, the next turn at once
        bool exactly = false;       // the bell does not end it
    };
    virtual Pause turn() = 0;
    virtual void sleep(std::uint32_t seen, const Pause& pause) {
        std::int64_t until = pause.until_ns;
        if (polled_ && !pause.exactly) until = std::min(until, steady_ns() + kLookEvery);
        bell.sleep(seen, until);
        while (pause.exactly && !interrupted_.load() && steady_ns() < pause.until_ns) bell.sleep(bell.count(), until);
    }
    bool interrupted() const { return interrupted_.load(); }

  private:
    // A loop in lock-step may never sleep, and would have the lock again before anybody else has woken.
    void let_in() const {
        constexpr timespec kShort{0, 20000};
        while (wanting_.load() > 0 && !interrupted_.load()) nanosleep(&kShort, nullptr);
    }

    std::mutex between_;
    std::atomic<int> wanting_{0};
    std::atomic<bool> interrupted_{false};
    std::atomic<bool> closed_{false};
    bool polled_;
    std::vector<std::unique_ptr<Inbox>> inboxes_;
};

// Numbers of a slow topic with one message per joint (temperatures), kept where the law reads them.
struct SlowInput {
    struct Row {
        Layout layout;
        std::size_t at;
        std::vector<double*> targets;
    };
    Inbox* inbox;
    std::vector<Row> rows;

    void drain() {
        while (inbox->take()) {
            const std::string_view data = inbox->message();
            for (Row& row : rows) {
                if (!row.layout.matches(data)) continue;
                for (double* target : row.targets) std::memcpy(target, data.data() + row.at, sizeof(double));
            }
        }
    }
};

// The loop of a node that acts when all inputs of a tick are there.
class JoinedLoop : public Loop {
  public:
    explicit JoinedLoop(std::int64_t dt_ns, bool poll = false) : Loop(dt_ns, poll), join_(dt_ns), fresh_(dt_ns) {}

    void add_input(Inbox& inbox, Input input, Translator translator) {
        fresh_.inputs.push_back(std::move(input));
        join_ = fresh_;
        sources_.emplace_back(inbox, std::move(translator));
    }
    void add_slow(SlowInput slow) { slow_.push_back(std::move(slow)); }
    // While an optional input was never seen, `to` is filled from `from` before the program runs; zero without one.
    void substitute(std::size_t input, const double* from, double* to, std::size_t count) {
        sources_.at(input).substitutes.push_back({from, to, count});
    }

    // Forgets ticks and bound run ids.
    void restart() {
        between([this] {
            join_ = fresh_;
            statistics.clear();
            last_stamp_ns_ = -1;
        });
    }
    // Messages of an input that were dropped: of another run id, and of a layout that cannot be read.
    std::pair<std::int64_t, std::int64_t> dropped(std::size_t input) const {
        const Source& source = sources_.at(input);
        return {source.other_run.load(), source.unreadable.load()};
    }
    bool seen(std::size_t input) const { return !join_.inputs.at(input).unseen; }
    std::int64_t tick() const { return join_.tick; }

    Program program, again;  // `again`: the present answer once more, for a sender that has not got it

  protected:
    struct Source {
        Source(Inbox& inbox, Translator translator) : inbox(&inbox), translator(std::move(translator)) {}
        Inbox* inbox;
        Translator translator;
        std::vector<CopyNumbers> substitutes;
        std::atomic<std::int64_t> other_run{0}, unreadable{0};
    };

    // Takes what is there, an input after the other, until all are empty; then waits for the last one missing: one
    // wake-up per tick.
    Pause turn() override {
        if (polled() || steady_ns() >= next_look_ns_) look_everywhere();
        bool found = true;
        while (found && !interrupted() && !failure.raised.load()) {
            found = false;
            for (std::size_t index = 0; index < sources_.size(); ++index) found = take(index) || found;
        }
        const std::size_t missing = join_.last_missing();
        for (std::size_t index = 0; index < sources_.size(); ++index) sources_[index].inbox->wake(index == missing);
        if (!sources_.empty() && sources_[missing].inbox->waiting()) return {};
        next_look_ns_ = steady_ns() + kLongestSleep;
        return {next_look_ns_, false};
    }

  private:
    void look_everywhere() {
        for (Source& source : sources_) source.inbox->look_again();
    }

    bool take(std::size_t index) {
        Inbox& inbox = *sources_[index].inbox;
        if (!inbox.waiting()) return false;
        const std::uint32_t arrivals = inbox.arrivals();
        if (!inbox.take()) {
            inbox.looked(arrivals);
            return false;
        }
        Offer outcome = join_.offer(index, inbox.message());
        if (outcome == kOtherLayout) {
            const std::string_view translated = sources_[index].translator.translate(inbox.message());
            if (!translated.empty()) outcome = join_.offer(index, translated);
        }
        if (outcome == kComplete) {
            act();
        } else if (outcome == kForeign || outcome == kOtherLayout) {
            Statistics::add(outcome == kForeign ? sources_[index].other_run : sources_[index].unreadable, 1);
            Statistics::add(statistics.foreign, 1);
        } else if (outcome == kRepeated && active.load() && last_stamp_ns_ >= 0) {
            again.run(join_.tick, last_stamp_ns_, failure);
        }
        return true;
    }

    void act() {
        if (!active.load()) return;
        const std::int64_t started = steady_ns(), tick = join_.tick, stamp_ns = tick * dt_ns;
        statistics.age(stamp_ns);
        for (SlowInput& slow : slow_) slow.drain();
        for (std::size_t index = 0; index < sources_.size(); ++index) {
            if (join_.inputs[index].unseen) stand_in(sources_[index]);
        }
        program.run(tick, stamp_ns, failure);
        last_stamp_ns_ = stamp_ns;
        statistics.incomplete.store(join_.incomplete, Statistics::kAny);
        statistics.ahead.store(join_.ahead, Statistics::kAny);
        statistics.tick(tick, started, steady_ns());
    }

    static void stand_in(const Source& source) {
        for (const CopyNumbers& copy : source.substitutes) {
            if (copy.from == nullptr) {
                std::memset(copy.to, 0, copy.count * sizeof(double));
            } else {
                std::memcpy(copy.to, copy.from, copy.count * sizeof(double));
            }
        }
    }

    Join join_, fresh_;
    std::deque<Source> sources_;
    std::vector<SlowInput> slow_;
    std::int64_t last_stamp_ns_ = -1, next_look_ns_ = 0;
};

}  // namespace hd
