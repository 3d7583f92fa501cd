// The growing end of an MCAP file: records are appended in memory and handed to the system in one write. A running CRC
// covers everything written so far; a process that is killed loses only what was not handed over.
#pragma once

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

namespace hd {

// ---------------------------------------------------------------------------------------------------------------------
// CRC-32 of zlib and MCAP, eight bytes at a time: tables[k] is the CRC of a byte followed by k zeros.

using CrcTables = std::array<std::array<std::uint32_t, 256>, 8>;

inline CrcTables make_crc_tables() {
    CrcTables tables{};
    for (std::uint32_t byte = 0; byte < 256; ++byte) {
        std::uint32_t crc = byte;
        for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0u);
        tables[0][byte] = crc;
    }
    for (std::size_t byte = 0; byte < 256; ++byte) {
        for (std::size_t k = 1; k < 8; ++k) {
            const std::uint32_t shorter = tables[k - 1][byte];
            tables[k][byte] = (shorter >> 8) ^ tables[0][shorter & 0xFF];
        }
    }
    return tables;
}

// The CRC of bytes that follow others with the CRC `before`; 0 at the beginning.
inline std::uint32_t crc32(std::string_view bytes, std::uint32_t before) {
    static const CrcTables tables = make_crc_tables();
    const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data());
    std::size_t left = bytes.size();
    std::uint32_t crc = ~before;
    for (; left >= 8; left -= 8, data += 8) {
        std::uint32_t low, high;
        std::memcpy(&low, data, 4);
        std::memcpy(&high, data + 4, 4);
        low ^= crc;
        crc = tables[7][low & 0xFF] ^ tables[6][(low >> 8) & 0xFF] ^ tables[5][(low >> 16) & 0xFF] ^
              tables[4][low >> 24] ^ tables[3][high & 0xFF] ^ tables[2][(high >> 8) & 0xFF] ^
              tables[1][(high >> 16) & 0xFF] ^ tables[0][high >> 24];
    }
    for (; left > 0; --left) crc = (crc >> 8) ^ tables[0][(crc ^ *data++) & 0xFF];
    return ~crc;
}

// ---------------------------------------------------------------------------------------------------------------------

// A write that the system refused; nothing is retried.
struct WriteFailure : std::runtime_error {
    WriteFailure(int code, const std::string& text) : std::runtime_error(text), code(code) {}
    int code;  // errno
};

// Hands bytes over and returns how many were taken, fewer than offered if the system likes. Throws WriteFailure.
using Sink = std::function<std::size_t(std::string_view)>;

class RecordFile {
  public:
    static constexpr std::uint8_t kMessage = 0x05;
    static constexpr std::size_t kMessageHead =
        31;  // opcode 1, length 8, channel 2, sequence 4, log time 8, publish time 8

    explicit RecordFile(Sink sink) : sink(std::move(sink)) {}

    // Everything below is to be called with this held: Python and a writing thread share the file.
    std::mutex mutex;
    Sink sink;

    // Returns the place of the first byte in the file.
    std::uint64_t append(std::string_view bytes) {
        const std::uint64_t at = end();
        pending_.append(bytes);
        return at;
    }
    void message(std::uint16_t channel, std::uint32_t sequence, std::int64_t log_ns, std::int64_t publish_ns,
                 std::string_view payload) {
        char head[kMessageHead];
        const std::uint64_t length = kMessageHead - 9 + payload.size();
        head[0] = static_cast<char>(kMessage);
        std::memcpy(head + 1, &length, 8);
        std::memcpy(head + 9, &channel, 2);
        std::memcpy(head + 11, &sequence, 4);
        std::memcpy(head + 15, &log_ns, 8);
        std::memcpy(head + 23, &publish_ns, 8);
        pending_.append(head, kMessageHead);
        pending_.append(payload);
        count(channel, 1, log_ns, log_ns);
    }
    // Messages that the statistics of the file shall name.
    void count(std::uint16_t channel, std::int64_t number, std::int64_t first_ns, std::int64_t last_ns) {
        first_ns_ = counts_.empty() ? first_ns : std::min(first_ns_, first_ns);
        last_ns_ = std::max(last_ns_, last_ns);
        counts_[channel] += number;
    }

    // One write, more only if the system takes less than all. Afterwards `position` says how far it came, also when
    // this throws.
    void flush() {
        std::size_t done = 0;
        try {
            while (done < pending_.size()) {
                const std::size_t taken = sink(std::string_view(pending_).substr(done));
                if (taken == 0) throw WriteFailure(EIO, "the file took no more bytes");
                done += taken;
            }
        } catch (...) {
            handed_over(done);
            throw;
        }
        handed_over(done);
    }

    std::uint64_t position() const { return position_; }               // bytes handed over
    std::uint64_t end() const { return position_ + pending_.size(); }  // length once all is handed over
    std::size_t pending() const { return pending_.size(); }            // bytes that a kill would lose now
    std::uint32_t crc() const { return crc_; }                         // of the bytes handed over
    const std::map<std::uint16_t, std::int64_t>& counts() const { return counts_; }
    std::int64_t first_ns() const { return first_ns_; }
    std::int64_t last_ns() const { return last_ns_; }

  private:
    void handed_over(std::size_t done) {
        crc_ = crc32(std::string_view(pending_).substr(0, done), crc_);
        position_ += done;
        pending_.erase(0, done);
    }

    std::string pending_;
    std::uint64_t position_ = 0;
    std::uint32_t crc_ = 0;
    std::map<std::uint16_t, std::int64_t> counts_;
    std::int64_t first_ns_ = 0, last_ns_ = 0;
};

}  // namespace hd
