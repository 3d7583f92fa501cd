// The recorder's two threads, neither of which ever asks for the interpreter: one takes every recorded topic from the
// middleware into the queues, one writes what is queued.
//
// The taking thread looks every 4 ms: at ten thousand messages a second that is cheaper than being woken for each. Both
// threads run at ordinary priority: a recorder must not delay the control chain.
//
// The middleware's own receiving thread is woken for each message, and that costs more than all the rest (measured:
// 13 of 17 % of a processor). So it rests for a part of a tick behind the first message of a bunch and then finds the
// others waiting. It rests in the new-message callback, which holds the lock of one reader that nothing but the taking
// thread waits for.
#pragma once

#include <pthread.h>
#include <sched.h>
#include <time.h>

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
    Repeated(const char* name, std::function<void()> work, std::chrono::milliseconds pause)
        : name_(name), work_(std::move(work)), pause_(pause) {}
    Repeated(const Repeated&) = delete;
    Repeated& operator=(const Repeated&) = delete;
    ~Repeated() { end(); }

    void start() {
        const std::lock_guard<std::mutex> owned(owner_);
        if (thread_.joinable()) return;
        ended_ = false;
        thread_ = std::thread([this] { run(); });
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
    void run() {
        pthread_setname_np(pthread_self(), name_);
        const sched_param ordinary{};
        sched_setscheduler(0, SCHED_OTHER, &ordinary);  // 0: this thread; refused only where there was nothing to leave
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
    const std::chrono::milliseconds pause_;
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
        : queues_(std::move(queues)),
          file_(std::move(file)),
          thread_("hd.write", [this] { write(); }, std::chrono::milliseconds(10)) {}

    void start() { thread_.start(); }
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

// Rests of a receiving thread: seven tenths of a tick behind a message that it had to wait for. Messages that follow
// each other at once are worked off without a rest, so a thread that is behind catches up.
class Rests {
  public:
    explicit Rests(std::int64_t dt_ns) : rest_{0, static_cast<long>(dt_ns * 7 / 10)} {}

    void message() {
        const bool waited = steady_ns() - last_.load() > kAtOnce;
        if (waited) nanosleep(&rest_, nullptr);
        last_.store(steady_ns());
    }

  private:
    static constexpr std::int64_t kAtOnce = 50000;  // ns; one message of a bunch takes 5000 to 10000
    static std::int64_t steady_ns() {
        timespec now{};
        clock_gettime(CLOCK_MONOTONIC, &now);
        return std::int64_t{now.tv_sec} * 1000000000 + now.tv_nsec;
    }
    const timespec rest_;
    std::atomic<std::int64_t> last_{0};
};

// Takes recorded topics from the middleware. While no recording is on, what comes is thrown away, so that nothing old
// is in the next one. Any thread may call any method. A pump that has ended stays ended.
class Pump {
  public:
    // Throws std::runtime_error where the loaded ROS 2 cannot be used like this.
    explicit Pump(std::int64_t dt_ns)
        : calls_(rcl::calls()),
          dt_ns_(dt_ns),
          rests_(dt_ns),
          thread_("hd.take", [this] { round(); }, std::chrono::milliseconds(4)) {}
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
    void start(bool rest) {
        const std::lock_guard<std::mutex> owned(owner_);
        if (ended_) return;
        if (rest && dt_ns_ >= kShortestTick && dt_ns_ <= kLongestTick && rcl::callbacks_are_safe(calls_)) listen();
        thread_.start();
    }
    // First no callback comes any more, then the thread ends, so that afterwards nothing of rcl is touched.
    void end() {
        const std::lock_guard<std::mutex> owned(owner_);
        ended_ = true;
        for (const void* subscription : heard_) calls_.on_new_message(subscription, nullptr, nullptr);
        heard_.clear();
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
    static constexpr int kAtOnce = 2000;           // messages of one topic before the next topic has its turn
    static constexpr std::size_t kKept = 1 << 20;  // bytes; memory of a larger message is given back

    struct Source {
        const void* subscription;
        bool paced;
    };

    static void arrived(const void* owner, std::size_t) {
        const_cast<Pump*>(static_cast<const Pump*>(owner))->rests_.message();
    }
    void listen() {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (const Source& source : sources_) {
            if (!source.paced) continue;
            if (calls_.on_new_message(source.subscription, &arrived, this) == rcl::kOk) {
                heard_.push_back(source.subscription);
            } else {
                calls_.reset_error();
            }
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
        for (int count = 0; count < kAtOnce && rcl::take(calls_, source.subscription, *buffer_, &info); ++count) {
            if (queues_ != nullptr) offer(number, info);
            if (source.paced) taken_.fetch_add(1);
            if (buffer_->view().size() > kKept) buffer_.emplace(kFirst);
        }
    }

    void offer(std::size_t number, const rcl::MessageInfo& info) {
        timespec now{};
        clock_gettime(CLOCK_REALTIME, &now);
        Origin origin{info.number != rcl::kNoNumber, {}, info.number};
        std::copy(std::begin(info.publisher), std::end(info.publisher), origin.publisher.begin());
        queues_->offer(number, std::int64_t{now.tv_sec} * 1000000000 + now.tv_nsec, buffer_->view(), origin);
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
    std::vector<const void*> heard_;  // subscriptions that have our callback
    std::mutex mutex_;                // held during a round
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
