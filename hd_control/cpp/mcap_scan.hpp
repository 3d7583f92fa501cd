// Walks the records of an MCAP file, or of one uncompressed chunk, in a memory buffer.
//
// A record is: opcode (1 byte), length (8 bytes, little-endian), content. A message's content is: channel (2), sequence
// (4), log time (8), publish time (8), payload. Nothing is read outside [data, data + size); the walk stops at the
// first record that does not fit and says where and why. No allocation depends on a length found in the file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace hd {

constexpr std::uint8_t OPCODE_FOOTER = 0x02;
constexpr std::uint8_t OPCODE_MESSAGE = 0x05;
constexpr std::size_t RECORD_HEADER = 9;
constexpr std::size_t MESSAGE_HEADER = 22;

struct McapScan {
    std::vector<std::uint16_t> channel;
    std::vector<std::uint32_t> sequence;
    std::vector<std::int64_t> log_time;
    std::vector<std::int64_t> publish_time;
    std::vector<std::int64_t> offset;  // of the payload
    std::vector<std::int64_t> length;  // of the payload
    std::vector<std::uint8_t> other_opcode;
    std::vector<std::int64_t> other_offset;  // of the content
    std::vector<std::int64_t> other_length;
    std::size_t stop = 0;     // first byte that was not understood or not visited
    const char* reason = "";  // why it stopped; empty at the end of the buffer
    bool footer = false;      // stopped behind a footer record
    bool limit = false;       // stopped because max_messages were found; more may follow
};

template <class Number>
Number read_little(const std::uint8_t* data) {
    Number value = 0;
    std::memcpy(&value, data, sizeof(Number));  // all supported machines are little-endian
    return value;
}

inline const char* message_problem(const std::uint8_t* content, std::uint64_t length) {
    if (length < MESSAGE_HEADER) return "message record shorter than its header";
    const bool in_range = read_little<std::uint64_t>(content + 6) <= static_cast<std::uint64_t>(INT64_MAX) &&
                          read_little<std::uint64_t>(content + 14) <= static_cast<std::uint64_t>(INT64_MAX);
    return in_range ? nullptr : "message time out of range";
}

inline void add_message(McapScan& found, const std::uint8_t* content, std::size_t at, std::uint64_t length) {
    found.channel.push_back(read_little<std::uint16_t>(content));
    found.sequence.push_back(read_little<std::uint32_t>(content + 2));
    found.log_time.push_back(read_little<std::int64_t>(content + 6));
    found.publish_time.push_back(read_little<std::int64_t>(content + 14));
    found.offset.push_back(static_cast<std::int64_t>(at + MESSAGE_HEADER));
    found.length.push_back(static_cast<std::int64_t>(length - MESSAGE_HEADER));
}

// Records from byte `start` on. `record_cap` bounds the length of one record, `max_messages` the messages of one call.
inline McapScan scan_records(const std::uint8_t* data, std::size_t size, std::size_t start, std::uint64_t record_cap,
                             std::size_t max_messages) {
    McapScan found;
    std::size_t at = start;
    while (at < size) {
        found.stop = at;
        if (size - at < RECORD_HEADER) return found.reason = "file ends inside a record header", found;
        const std::uint8_t opcode = data[at];
        const auto length = read_little<std::uint64_t>(data + at + 1);
        const std::size_t content = at + RECORD_HEADER;
        if (opcode == 0) return found.reason = "record with opcode 0", found;
        if (length > record_cap) return found.reason = "record length above the cap", found;
        if (length > size - content) return found.reason = "file ends inside a record", found;
        if (opcode == OPCODE_MESSAGE) {
            if (found.channel.size() >= max_messages) return found.limit = true, found;
            if (const char* problem = message_problem(data + content, length)) return found.reason = problem, found;
            add_message(found, data + content, content, length);
        } else {
            found.other_opcode.push_back(opcode);
            found.other_offset.push_back(static_cast<std::int64_t>(content));
            found.other_length.push_back(static_cast<std::int64_t>(length));
        }
        at = content + static_cast<std::size_t>(length);
        if (opcode == OPCODE_FOOTER) return found.stop = at, found.footer = true, found;
    }
    found.stop = size > start ? at : start;
    return found;
}

// True if `length` bytes at `offset` lie inside a buffer of `size` bytes.
inline bool inside(std::int64_t offset, std::int64_t length, std::size_t size) {
    return offset >= 0 && length >= 0 && static_cast<std::uint64_t>(offset) <= size &&
           static_cast<std::uint64_t>(length) <= size - static_cast<std::size_t>(offset);
}

// True if the payload has the fixed bytes of a layout: (payload & mask) == fixed, and at most `surplus` bytes more.
inline bool has_layout(const std::uint8_t* payload, std::int64_t length, const std::uint8_t* fixed,
                       const std::uint8_t* mask, std::int64_t size, std::int64_t surplus) {
    if (length < size || length > size + surplus) return false;
    std::uint8_t difference = 0;
    for (std::int64_t i = 0; i < size; ++i) difference |= static_cast<std::uint8_t>((payload[i] ^ fixed[i]) & mask[i]);
    return difference == 0;
}

}  // namespace hd
