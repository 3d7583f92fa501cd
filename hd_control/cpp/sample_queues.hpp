// Bounded queues between what arrives and a file: every sample that was published is written or counted as dropped.
//
// Two threads meet here: one offers and never waits for the disk, one drains. Overload drops the oldest sensor sample
// first; events (goals, faults, descriptions) are never dropped before a sensor sample. A disk that refuses ends it:
// what is queued then and what is offered from then on counts as lost on the disk.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "accounts.hpp"
#include "record_file.hpp"

namespace hd {

struct QueueLimits {
    std::size_t samples;  // of all topics together
    std::size_t bytes;    // of all topics together
    std::size_t record;   // of one record; a longer one would be refused by the reader
};

struct QueuedTopic {
    std::uint16_t channel;
    Head head;
    std::size_t depth;  // samples of this topic
    bool event;
    bool awaited;  // its newest stamp counts from the beginning on
    bool paced;    // its newest stamp counts once there is one
    std::shared_ptr<Account> account;
};

class SampleQueues {
  public:
    explicit SampleQueues(const QueueLimits& limits) : limits_(limits) {}

    // Topics are added before the first sample; returns the topic's number.
    std::size_t add(QueuedTopic topic) {
        const std::lock_guard<std::mutex> lock(mutex_);
        topics_.emplace_back(std::move(topic));
        return topics_.size() - 1;
    }

    // Takes one sample. Never waits for the disk.
    void offer(std::size_t number, std::int64_t log_ns, std::string_view payload, const Origin& origin) {
        const std::lock_guard<std::mutex> lock(mutex_);
        Topic& topic = topics_.at(number);
        const StampAndFrame head = stamp_and_frame(topic.head, payload);
        topic.account->see(head, origin, true);
        if (head.stamped) topic.newest_ns = std::max(topic.newest_ns, head.stamp_ns);
        if (failed_) return topic.account->lost_on_disk(1);
        if (payload.size() + RecordFile::kMessageHead > limits_.record) return topic.account->refused(1);
        topic.samples.push_back({log_ns, head.stamped, head.stamp_ns, std::string(payload)});
        samples_ += 1;
        bytes_ += payload.size();
        make_room(topic);
    }

    // Writes up to `limit` samples, in order of log time over all topics, as one write. Returns how many; at a
    // WriteFailure the counts are right when it passes through, and nothing is taken any more.
    std::size_t drain(RecordFile& file, std::size_t limit) {
        const std::lock_guard<std::mutex> whole(file.mutex);
        if (failed()) return 0;
        const std::vector<Taken> batch = take(limit);
        for (const Taken& taken : batch) {
            const Sample& sample = taken.sample;
            const std::int64_t log_ns = in_order(std::max<std::int64_t>(sample.log_ns, 0));
            const std::int64_t publish_ns = sample.stamped ? std::max<std::int64_t>(sample.stamp_ns, 0) : log_ns;
            file.message(taken.topic->channel, taken.topic->sequence++, log_ns, publish_ns, sample.bytes);
        }
        const std::uint64_t begin = file.end() - size_of(batch);
        try {
            file.flush();
        } catch (...) {
            settle(batch, begin, file.position());
            fail();
            throw;
        }
        settle(batch, begin, file.position());
        return batch.size();
    }

    // Ends the recording: what is queued and what comes from now on counts as lost on the disk.
    void fail() {
        const std::lock_guard<std::mutex> lock(mutex_);
        failed_ = true;
        for (Topic& topic : topics_) {
            topic.account->lost_on_disk(static_cast<std::int64_t>(topic.samples.size()));
            topic.samples.clear();
        }
        samples_ = bytes_ = 0;
    }

    // A sample that was taken late is logged no earlier than what stands in the file: readers of files without an index
    // need it. A clock that was set back by more stays as it is.
    std::int64_t in_order(std::int64_t log_ns) {
        constexpr std::int64_t kLate = 1000000000;
        if (log_ns > logged_ || logged_ - log_ns > kLate) logged_ = log_ns;
        return logged_;
    }

    bool failed() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        return failed_;
    }

    // Per topic: its counts and how many samples are in the queue or on their way to the file, at one moment.
    std::vector<std::pair<Counts, std::size_t>> table() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        std::vector<std::pair<Counts, std::size_t>> rows;
        for (const Topic& topic : topics_) {
            rows.emplace_back(topic.account->counts(), topic.samples.size() + topic.in_flight);
        }
        return rows;
    }

    // The newest stamp of the slowest topic; -1 while an awaited one has none.
    std::int64_t slowest_ns() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        std::int64_t slowest = INT64_MAX;
        for (const Topic& topic : topics_) {
            if (topic.awaited || (topic.paced && topic.newest_ns >= 0)) slowest = std::min(slowest, topic.newest_ns);
        }
        return slowest == INT64_MAX ? -1 : slowest;
    }

  private:
    struct Sample {
        std::int64_t log_ns;
        bool stamped;
        std::int64_t stamp_ns;
        std::string bytes;
    };
    struct Topic : QueuedTopic {
        explicit Topic(QueuedTopic description) : QueuedTopic(std::move(description)) {}
        std::deque<Sample> samples;
        std::size_t in_flight = 0;
        std::uint32_t sequence = 0;  // of its next message in the file
        std::int64_t newest_ns = -1;
    };
    struct Taken {
        Topic* topic;
        Sample sample;
    };

    void make_room(Topic& newest) {
        if (newest.samples.size() > newest.depth) {
            drop_oldest(newest);
        } else if (samples_ > limits_.samples) {
            if (Topic* sensor = longest(false)) drop_oldest(*sensor);
        }
        while (bytes_ > limits_.bytes) {
            Topic* sensor = longest(false);
            drop_oldest(sensor != nullptr ? *sensor : *longest(true));
        }
    }
    Topic* longest(bool event) {
        Topic* found = nullptr;
        for (Topic& topic : topics_) {
            const std::size_t most = found == nullptr ? 0 : found->samples.size();
            if (topic.event == event && topic.samples.size() > most) found = &topic;
        }
        return found;
    }
    void drop_oldest(Topic& topic) {
        bytes_ -= topic.samples.front().bytes.size();
        samples_ -= 1;
        topic.samples.pop_front();
        topic.account->lost_in_queue(1);
    }

    std::vector<Taken> take(std::size_t limit) {
        std::vector<Taken> batch;
        const std::lock_guard<std::mutex> lock(mutex_);
        batch.reserve(std::min(limit, samples_));
        for (Topic& topic : topics_) {
            topic.sequence = static_cast<std::uint32_t>(topic.account->counts().written);
            while (!topic.samples.empty() && batch.size() < limit) {
                bytes_ -= topic.samples.front().bytes.size();
                samples_ -= 1;
                topic.in_flight += 1;
                batch.push_back({&topic, std::move(topic.samples.front())});
                topic.samples.pop_front();
            }
        }
        std::stable_sort(batch.begin(), batch.end(),
                         [](const Taken& a, const Taken& b) { return a.sample.log_ns < b.sample.log_ns; });
        return batch;
    }

    static std::uint64_t size_of(const std::vector<Taken>& batch) {
        std::uint64_t size = 0;
        for (const Taken& taken : batch) size += RecordFile::kMessageHead + taken.sample.bytes.size();
        return size;
    }

    // Counts a batch that began at byte `begin` of the file as written as far as the file came.
    void settle(const std::vector<Taken>& batch, std::uint64_t begin, std::uint64_t position) {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (const Taken& taken : batch) {
            begin += RecordFile::kMessageHead + taken.sample.bytes.size();
            if (begin <= position) {
                taken.topic->account->wrote(1);
            } else {
                taken.topic->account->lost_on_disk(1);
            }
            taken.topic->in_flight -= 1;
        }
    }

    mutable std::mutex mutex_;
    QueueLimits limits_;
    std::deque<Topic> topics_;  // their places stay
    std::size_t samples_ = 0, bytes_ = 0;
    std::int64_t logged_ = 0;  // log time of the newest sample in the file
    bool failed_ = false;
};

}  // namespace hd
