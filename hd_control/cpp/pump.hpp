// The recorder's two threads, neither of which ever asks for the interpreter: one takes every recorded topic from the
// middleware into the queues, one writes what is queued.
//
// The taking thread looks every 4 ms: at ten thousand messages a second that is cheaper than being woken for each. It
// runs at the priority of the receiving threads, below the control loops: both want the lock of a reader, and where an
// ordinary program could take the processor from the one, the other would stand still until its queue in shared memory
// has run over. The writing thread is an ordinary one.
//
// The middleware's own receiving thread is woken for each message, and that costs more than all the rest, there and in
// the process that publishes. So it rests behind the first message of a tick and then finds others waiting. It rests in
// the new-message callback, which holds the lock of that one reader; nothing but the taking thread waits for it.
#pragma once

#include <pthread.h>
#include <sched.h>
#include <time.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rcl_access.hpp"
#include "sample_queues.hpp"

namespace hd {

// Calls `work` again and again, `pause` after it has returned, until the end. Any thread may start and end it.
class Repeated {
  public:
    Repeated(const char* name, std::function<void()> work) : name_(name), work_(std::move(work)) {}
    Repeated(const Repeated&) = delete;
    Repeated& operator=(const Repeated&) = delete;
    ~Repeated() { end(); }

    // `priority`: of SCHED_FIFO, 0: an ordinary thread; where it is not permitted the thread stays what its maker is.
    void start(std::chrono::milliseconds pause, int priority) {
        const std::lock_guard<std::mutex> owned(owner_);
        if (thread_.joinable()) return;
        ended_ = false;
        pause_ = pause;
        thread_ = std::thread([this, priority] { run(priority); });
    }
    void end() {
        const std::lock_guard<std::mutex> owned(owner_);
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            ended_ = true;
        }
        wake_.notify_all();
        if (thread_.joinable()) thread_.join();
    }

  private:
    void run(int priority) {
        pthread_setname_np(pthread_self(), name_);
        sched_param wanted{};
        wanted.sched_priority = priority;
        sched_setscheduler(0, priority > 0 ? SCHED_FIFO : SCHED_OTHER, &wanted);  // 0: this thread
        std::unique_lock<std::mutex> lock(mutex_);
        while (!ended_) {
            lock.unlock();
            work_();
            lock.lock();
            if (!ended_) wake_.wait_for(lock, pause_);
        }
    }
    const char* const name_;  // at most 15 characters
    const std::function<void()> work_;
    std::chrono::milliseconds pause_{};
    std::mutex owner_;  // held while the thread is made or waited for
    std::mutex mutex_;
    std::condition_variable wake_;
    bool ended_ = false;
    std::thread thread_;
};

// Writes what is queued every 10 ms, and at its end. A failure ends the writing and stays to be read.
class Writer {
  public:
    Writer(std::shared_ptr<SampleQueues> queues, std::shared_ptr<RecordFile> file)
        : queues_(std::move(queues)), file_(std::move(file)), thread_("hd.write", [this] { write(); }) {}

    void start() { thread_.start(std::chrono::milliseconds(10), 0); }
    void end() {
        thread_.end();
        write();
    }
    std::optional<WriteFailure> failure() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        return failure_;
    }

  private:
    void write() {
        if (failure().has_value()) return;
        try {
            queues_->drain(*file_, SIZE_MAX);
        } catch (const WriteFailure& failure) {
            note(failure);
        } catch (const std::exception& error) {  // no memory, or a file that is a Python object and raised
            note(WriteFailure(EIO, error.what()));
        }
    }
    void note(const WriteFailure& failure) {
        const std::lock_guard<std::mutex> lock(mutex_);
        failure_ = failure;
    }
    std::shared_ptr<SampleQueues> queues_;
    std::shared_ptr<RecordFile> file_;
    mutable std::mutex mutex_;
    std::optional<WriteFailure> failure_;
    Repeated thread_;  // last: it ends before what it uses
};

// Rests of a receiving thread, 1.7 ticks behind a message that begins one: it works off two ticks at once. Ticks that
// follow each other at once are worked off without a rest. A thread that is behind, because others had its processor or
// a lock, does not rest until it has caught up: the queue that it takes from holds 512 messages of all topics.
class Rests {
  public:
    explicit Rests(std::int64_t dt_ns)
        : rest_{0, static_cast<long>(dt_ns * 17 / 10)},
          between_ns_(dt_ns / 5),
          behind_ns_(rest_.tv_nsec + 3 * dt_ns),
          caught_up_ns_(rest_.tv_nsec + dt_ns / 2) {}

    void tick() {
        if (steady_ns() - last_.load() > between_ns_ && !behind_.load()) nanosleep(&rest_, nullptr);
        last_.store(steady_ns());
    }
    // How long the newest message of a topic was on its way.
    void arrived_after(std::int64_t delay_ns) {
        if (delay_ns > behind_ns_) behind_.store(true);
        if (delay_ns < caught_up_ns_) behind_.store(false);
    }

  private:
    static std::int64_t steady_ns() {
        timespec now{};
        clock_gettime(CLOCK_MONOTONIC, &now);
        return std::int64_t{now.tv_sec} * 1000000000 + now.tv_nsec;
    }
    const timespec rest_;
    const std::int64_t between_ns_, behind_ns_, caught_up_ns_;
    std::atomic<std::int64_t> last_{0};
    std::atomic<bool> behind_{false};
};

// Takes recorded topics from the middleware. While no recording is on, what comes is thrown away, so that nothing old
// is in the next one. Any thread may call any method. A pump that has ended stays ended.
class Pump {
  public:
    // Throws std::runtime_error where the loaded ROS 2 cannot be used like this.
    explicit Pump(std::int64_t dt_ns)
        : calls_(rcl::calls()), dt_ns_(dt_ns), rests_(dt_ns), thread_("hd.take", [this] { round(); }) {}
    Pump(const Pump&) = delete;
    Pump& operator=(const Pump&) = delete;
    ~Pump() { end(); }

    // A subscription, by its address; it must live until `end` has returned. `paced`: its messages count in `taken`,
    // and come often enough for rests behind them.
    void add(const void* subscription, bool paced) {
        const std::lock_guard<std::mutex> lock(mutex_);
        sources_.push_back({subscription, paced});
    }

    // Progress is published from now on: a std_msgs/UInt64 with the newest tick that is here of every topic.
    void report_to(const void* publisher) {
        const std::lock_guard<std::mutex> lock(mutex_);
        publisher_ = publisher;
    }
    // `rest`: the receiving thread rests within each tick. Not for lock-step, where ticks follow each other at once,
    // nor for ticks that are shorter than the bunch of their messages takes.
    void start(bool rest, int priority) {
        const std::lock_guard<std::mutex> owned(owner_);
        if (ended_) return;
        const bool resting = rest && dt_ns_ >= kShortestTick && dt_ns_ <= kLongestTick;
        if (resting && rcl::callbacks_are_safe(calls_)) listen();
        thread_.start(std::chrono::milliseconds(resting ? 8 : 4), priority);
    }
    // First no callback comes any more, then the thread ends, so that afterwards nothing of rcl is touched.
    void end() {
        const std::lock_guard<std::mutex> owned(owner_);
        ended_ = true;
        if (heard_ != nullptr) calls_.on_new_message(heard_, nullptr, nullptr);
        heard_ = nullptr;
        thread_.end();
        const std::lock_guard<std::mutex> lock(mutex_);
        sources_.clear();
        publisher_ = nullptr;
    }

    // A recording begins: source i goes to topic i of the queues. None: the recording is over; when this returns
    // nothing goes to it any more.
    void record(std::shared_ptr<SampleQueues> queues) {
        const std::lock_guard<std::mutex> lock(mutex_);
        queues_ = std::move(queues);
        reported_ns_ = -1;
    }
    std::int64_t taken() const { return taken_.load(); }

  private:
    static constexpr std::int64_t kShortestTick = 900000, kLongestTick = 10000000;  // ns
    static constexpr int kAtOnce = 2000;  // messages of one topic before the next topic has its turn
    static constexpr std::int64_t kLongestWait = 60000000000;  // ns in the middleware's queue
    static constexpr std::size_t kKept = 1 << 20;              // bytes; memory of a larger message is given back

    struct Source {
        const void* subscription;
        bool paced;
    };

    static void arrived(const void* owner, std::size_t) {
        const_cast<Pump*>(static_cast<const Pump*>(owner))->rests_.tick();
    }
    // Hears the first paced topic: its messages begin a tick.
    void listen() {
        const std::lock_guard<std::mutex> lock(mutex_);
        const auto first =
            std::find_if(sources_.begin(), sources_.end(), [](const Source& source) { return source.paced; });
        if (first == sources_.end()) return;
        if (calls_.on_new_message(first->subscription, &arrived, this) == rcl::kOk) {
            heard_ = first->subscription;
        } else {
            calls_.reset_error();
        }
    }

    void round() {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (std::size_t number = 0; number < sources_.size(); ++number) take_from(number);
        report();
    }

    void take_from(std::size_t number) {
        const Source& source = sources_[number];
        rcl::MessageInfo info{};
        int count = 0;
        for (; count < kAtOnce && rcl::take(calls_, source.subscription, *buffer_, &info); ++count) {
            if (queues_ != nullptr) offer(number, info);
            if (buffer_->view().size() > kKept) buffer_.emplace(kFirst);
        }
        if (count == 0 || !source.paced) return;
        taken_.fetch_add(count);
        rests_.arrived_after(info.received_ns - info.sent_ns);
    }

    void offer(std::size_t number, const rcl::MessageInfo& info) {
        Origin origin{info.number != rcl::kNoNumber, {}, info.number};
        std::copy(std::begin(info.publisher), std::end(info.publisher), origin.publisher.begin());
        queues_->offer(number, arrival_ns(info), buffer_->view(), origin);
    }

    // When the middleware received it; where it does not say, or the clock was set meanwhile, now.
    static std::int64_t arrival_ns(const rcl::MessageInfo& info) {
        timespec clock{};
        clock_gettime(CLOCK_REALTIME, &clock);
        const std::int64_t now = std::int64_t{clock.tv_sec} * 1000000000 + clock.tv_nsec;
        return info.received_ns > now - kLongestWait && info.received_ns <= now ? info.received_ns : now;
    }

    void report() {
        if (publisher_ == nullptr || queues_ == nullptr) return;
        const std::int64_t slowest = queues_->slowest_ns();
        if (slowest <= reported_ns_) return;
        reported_ns_ = slowest;
        const std::int64_t tick = (slowest + dt_ns_ / 2) / dt_ns_;
        std::memcpy(&message_[4], &tick, sizeof tick);
        rcl::publish(calls_, publisher_, message_);
    }

    static constexpr std::size_t kFirst = 4096;
    const rcl::Calls& calls_;
    const std::int64_t dt_ns_;
    Rests rests_;
    std::mutex owner_;  // held while the pump is started or ended
    bool ended_ = false;
    const void* heard_ = nullptr;  // the subscription that has our callback
    std::mutex mutex_;             // held during a round
    std::vector<Source> sources_;
    std::optional<rcl::Buffer> buffer_{std::in_place, kFirst};
    std::shared_ptr<SampleQueues> queues_;
    const void* publisher_ = nullptr;
    std::int64_t reported_ns_ = -1;
    std::string message_{std::string("\x00\x01\x00\x00", 4) + std::string(8, '\0')};
    std::atomic<std::int64_t> taken_{0};
    Repeated thread_;  // last: it ends before what it uses
};

}  // namespace hd
