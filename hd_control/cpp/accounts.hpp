// What arrived on a topic, what was written, what is missing and where it was lost: counted from stamps and from the
// numbers that a publisher gives its messages.
//
// Two counters look at the same stream. The stamps say which ticks are missing; the publisher's numbers say how many
// messages were published and did not arrive. A tick that is missing although no number is was never published. Where
// no numbers are known every missing tick counts as lost on the way.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

namespace hd {

// ---------------------------------------------------------------------------------------------------------------------
// Stamp and stream of a serialised message (CDR, little-endian).

enum class Head { none, header, clock };  // begins with a std_msgs/Header, with a time, with neither

struct StampAndFrame {
    bool stamped = false;
    std::int64_t stamp_ns = 0;
    std::string_view frame;  // into the message
};

constexpr std::size_t kLongestFrame = 1024;

template <class Number>
Number little(std::string_view bytes, std::size_t at) {
    Number value;
    std::memcpy(&value, bytes.data() + at, sizeof value);  // all supported machines are little-endian
    return value;
}

inline StampAndFrame stamp_and_frame(Head head, std::string_view bytes) {
    if (bytes.size() < (head == Head::clock ? 12u : 16u) || head == Head::none) return {};
    StampAndFrame found{
        true, little<std::int32_t>(bytes, 4) * std::int64_t{1000000000} + little<std::uint32_t>(bytes, 8), {}};
    if (head == Head::clock) return found;
    const std::size_t length = little<std::uint32_t>(bytes, 12);  // with the zero at its end
    if (length > 0 && length <= kLongestFrame) found.frame = bytes.substr(16, length - 1);
    return found;
}

// ---------------------------------------------------------------------------------------------------------------------

// Who published a message, and the how-manieth of that publisher it is; unknown where the middleware does not say.
struct Origin {
    bool known = false;
    std::array<std::uint8_t, 16> publisher{};
    std::uint64_t number = 0;
};

struct Drops {
    std::int64_t transport = 0, queue = 0, disk = 0, size = 0;
    std::int64_t total() const { return transport + queue + disk + size; }
};

struct Counts {
    std::int64_t received = 0, written = 0, gaps = 0, missing = 0, duplicates = 0, out_of_order = 0;
    std::int64_t never_published = 0;
    Drops drops;
};

// The counts of one topic; any thread may call any method. `period_ns` is the tick of its stamps; 0 means that missing
// ticks cannot be seen. Streams on one topic are kept apart by frame id (run id of the publisher, joint of a
// temperature): a stream that begins is not a gap, one that jumps by n ticks has n - 1 missing samples. More than
// kStreams streams or publishers are received and written like all others, but their gaps are not looked for.
class Account {
  public:
    static constexpr std::size_t kStreams = 1000;

    explicit Account(std::int64_t period_ns) : period_ns(period_ns) {}

    // One sample that arrived. `lossy`: what is missing was lost on the way (a recorder); else it is only missing.
    void see(const StampAndFrame& head, const Origin& origin, bool lossy) {
        const std::lock_guard<std::mutex> lock(mutex_);
        counts_.received += 1;
        if (lossy && origin.known) lost_numbers(origin);
        if (!head.stamped || period_ns <= 0) return;
        Stream* stream = find(streams_, recent_stream_, head.frame);
        if (stream == nullptr) {
            if (streams_.size() < kStreams)
                streams_.push_back({std::string(head.frame), head.stamp_ns, counts_.drops.transport});
            return;
        }
        compare(*stream, head.stamp_ns, lossy, origin.known);
    }
    void wrote(std::int64_t count) {
        change([&] { counts_.written += count; });
    }
    void lost_in_queue(std::int64_t count) {
        change([&] { counts_.drops.queue += count; });
    }
    void lost_on_disk(std::int64_t count) {
        change([&] { counts_.drops.disk += count; });
    }
    void refused(std::int64_t count) {
        change([&] { counts_.drops.size += count; });
    }

    Counts counts() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        return counts_;
    }
    std::vector<std::string> frames() const {
        const std::lock_guard<std::mutex> lock(mutex_);
        std::vector<std::string> found;
        for (const Stream& stream : streams_) found.push_back(stream.key);
        return found;
    }

    const std::int64_t period_ns;

  private:
    using Wide = __int128;  // the difference of two stamps of a hostile message has more than 64 bits

    struct Stream {
        std::string key;
        std::int64_t last_ns;
        std::int64_t lost_before;  // messages of the topic lost on the way, when this stream was last heard
    };
    struct Publisher {
        std::array<std::uint8_t, 16> key;
        std::uint64_t number;
    };

    template <class Change>
    void change(Change&& what) {
        const std::lock_guard<std::mutex> lock(mutex_);
        what();
    }

    // The entry with this key; most often it is the one of the last time.
    template <class Entry, class Key>
    static Entry* find(std::vector<Entry>& entries, std::size_t& recent, const Key& key) {
        if (recent < entries.size() && entries[recent].key == key) return &entries[recent];
        for (std::size_t i = 0; i < entries.size(); ++i) {
            if (entries[i].key == key) return &entries[recent = i];
        }
        return nullptr;
    }

    void lost_numbers(const Origin& origin) {
        Publisher* publisher = find(publishers_, recent_publisher_, origin.publisher);
        if (publisher == nullptr) {
            if (publishers_.size() < kStreams) publishers_.push_back({origin.publisher, origin.number});
            return;
        }
        if (origin.number <= publisher->number) return;
        counts_.drops.transport += static_cast<std::int64_t>(origin.number - publisher->number - 1);
        publisher->number = origin.number;
    }

    void compare(Stream& stream, std::int64_t stamp_ns, bool lossy, bool numbered) {
        const Wide step = Wide{stamp_ns} - stream.last_ns;
        const std::int64_t ticks = nearest(step);
        if (ticks > 1) {
            const std::int64_t missing = ticks - 1;
            counts_.gaps += 1;
            counts_.missing += missing;
            if (lossy && !numbered) counts_.drops.transport += missing;
            if (numbered) counts_.never_published += std::max<std::int64_t>(0, missing - lost_since(stream));
        } else if (step == 0) {
            counts_.duplicates += 1;
        } else if (step < 0) {
            counts_.out_of_order += 1;
        }
        stream.last_ns = std::max(stream.last_ns, stamp_ns);
        stream.lost_before = counts_.drops.transport;
    }
    std::int64_t lost_since(const Stream& stream) const { return counts_.drops.transport - stream.lost_before; }

    // Whole ticks in a step of the stamps, rounded to the nearest, halves up.
    std::int64_t nearest(Wide step_ns) const {
        const Wide doubled = 2 * step_ns + period_ns, double_period = 2 * Wide{period_ns};
        const Wide whole = doubled / double_period;
        return static_cast<std::int64_t>(doubled % double_period < 0 ? whole - 1 : whole);
    }

    mutable std::mutex mutex_;
    Counts counts_;
    std::vector<Stream> streams_;
    std::vector<Publisher> publishers_;
    std::size_t recent_stream_ = 0, recent_publisher_ = 0;
};

}  // namespace hd
