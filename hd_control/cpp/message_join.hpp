// Fixed-layout CDR messages of one tick, joined and written straight into the blocks that a law reads.
//
// A `Layout` knows which bytes of a message never change (names, counts, encapsulation), where its stamp and its run id
// are, and which double goes where. `Join` collects one message per input until all inputs of one tick are there.
// Every read is inside the checked length.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

namespace hd {

constexpr std::size_t kSurplus = 8;    // unused bytes that a serialiser may append
constexpr std::int64_t kLeap = 1000;   // ticks; a message further ahead must be confirmed by the next of its input

// builtin_interfaces/Time at a place of a message.
inline void put_stamp(std::string& bytes, std::size_t at, std::int64_t stamp_ns) {
    const auto seconds = static_cast<std::int32_t>(stamp_ns / 1000000000);
    const auto nanoseconds = static_cast<std::uint32_t>(stamp_ns - static_cast<std::int64_t>(seconds) * 1000000000);
    std::memcpy(bytes.data() + at, &seconds, 4);
    std::memcpy(bytes.data() + at + 4, &nanoseconds, 4);
}

struct Copy {
    std::size_t from;  // byte offset in the message
    double* to;
};

struct Layout {
    std::string fixed, mask;  // bytes that never change, and 0xff where they are
    std::size_t stamp_at = 0, frame_at = 0, frame_length = 0;

    bool matches(std::string_view data) const {
        if (data.size() < fixed.size() || data.size() > fixed.size() + kSurplus) return false;
        unsigned char differs = 0;
        for (std::size_t i = 0; i < fixed.size(); ++i) {
            differs = static_cast<unsigned char>(differs | ((data[i] ^ fixed[i]) & mask[i]));
        }
        return differs == 0;
    }
    std::int64_t stamp_ns(std::string_view data) const {
        std::int32_t seconds;
        std::uint32_t nanoseconds;
        std::memcpy(&seconds, data.data() + stamp_at, 4);
        std::memcpy(&nanoseconds, data.data() + stamp_at + 4, 4);
        return static_cast<std::int64_t>(seconds) * 1000000000 + nanoseconds;
    }
};

struct Input {
    Layout layout;
    std::vector<Copy> copies;
    std::string run_id;  // empty: not bound yet
    double* tick_to = nullptr;  // takes the tick of the message, beside its numbers
    std::int64_t leap = -1;     // tick of the last message that was too far ahead, until another one comes
    bool filled = false, unseen = false;

    // A stamp far ahead is taken when the next message of the same input goes on from there: a source that stood still
    // for long. One wild stamp alone would leave the others behind for ever.
    bool leaps(std::int64_t found, std::int64_t tick) {
        const bool far = tick >= 0 && found - tick > kLeap;
        const bool confirmed = leap >= 0 && found >= leap && found - leap <= kLeap;
        leap = far && !confirmed ? found : -1;
        return far && !confirmed;
    }
};

enum Offer { kStored = 0, kComplete = 1, kOtherLayout = 2, kForeign = 3, kStale = 4, kRepeated = 5, kAhead = 6 };

struct Join {
    std::vector<Input> inputs;
    std::int64_t dt_ns;
    std::int64_t tick = -1;
    std::int64_t incomplete = 0, stale = 0, ahead = 0;
    bool open = false, joined_once = false;

    explicit Join(std::int64_t dt) : dt_ns(dt) {}

    // Takes one message. A newer tick abandons an incomplete older one; a tick that is past, already there, or far ahead
    // is dropped.
    Offer offer(std::size_t index, std::string_view data) {
        Input& input = inputs[index];
        if (!input.layout.matches(data)) return kOtherLayout;
        const std::string_view run_id = data.substr(input.layout.frame_at, input.layout.frame_length);
        if (input.run_id.empty()) {
            input.run_id = std::string(run_id);
        } else if (run_id != input.run_id) {
            return kForeign;
        }
        const std::int64_t found = (input.layout.stamp_ns(data) + dt_ns / 2) / dt_ns;
        if (input.leaps(found, tick)) {
            ++ahead;
            return kAhead;
        }
        if (input.unseen) input.unseen = input.filled = false;
        if (found > tick) {
            begin(found);
        } else if (found < tick || input.filled) {
            ++stale;
            return found == tick && !open && index + 1 == inputs.size() ? kRepeated : kStale;
        }
        for (const Copy& copy : input.copies) std::memcpy(copy.to, data.data() + copy.from, sizeof(double));
        if (input.tick_to != nullptr) *input.tick_to = static_cast<double>(found);
        input.filled = true;
        for (const Input& each : inputs) {
            if (!each.filled) return kStored;
        }
        open = false;
        joined_once = true;
        return kComplete;
    }

    void begin(std::int64_t next) {
        if (open && joined_once) ++incomplete;
        tick = next;
        open = true;
        for (Input& each : inputs) each.filled = each.unseen;
    }

    // The highest input that the present tick still needs: the one worth waiting for.
    std::size_t last_missing() const {
        if (!open) return inputs.size() - 1;
        for (std::size_t i = inputs.size(); i-- > 0;) {
            if (!inputs[i].filled) return i;
        }
        return inputs.size() - 1;
    }
};

}  // namespace hd
