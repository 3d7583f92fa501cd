// Any sensor_msgs/JointState as it arrives: where its parts are, and the same message in a layout that is expected.
//
// Programs of other people order the joints as they like, leave arrays out and have run ids of any length. Such a
// message is read by joint name, with every length checked against the bytes that are there; it never allocates.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "message_join.hpp"

namespace hd {

constexpr std::size_t kNamesRead = 1024;  // more joints than this are nobody's arm

// Reads CDR (XCDR1) of either byte order; alignment counts from the byte after the four of the encapsulation.
class CdrCursor {
  public:
    explicit CdrCursor(std::string_view data) : data_(data) {
        good_ = data.size() >= kHead && data[0] == 0 && (data[1] == 0 || data[1] == 1);
        swapped_ = good_ && data[1] == 0;
    }
    bool good() const { return good_; }
    bool swapped() const { return swapped_; }
    std::size_t at() const { return at_; }

    std::uint32_t number() {
        align(4);
        return read<std::uint32_t>();
    }
    std::string_view text() {
        const std::uint32_t length = number();
        if (!reserve(length)) return {};
        const std::string_view found = data_.substr(at_, length);
        at_ += length;
        return length > 0 && found.back() == '\0' ? found.substr(0, length - 1) : found;
    }
    // Steps over `count` doubles; returns where they are.
    std::size_t doubles(std::size_t count) {
        if (count == 0) return at_;
        align(8);
        const std::size_t start = at_;
        if (count > data_.size() || !reserve(8 * count)) return start;
        at_ += 8 * count;
        return start;
    }
    double double_at(std::size_t place) {
        at_ = place;
        return read<double>();
    }

  private:
    static constexpr std::size_t kHead = 4;

    void align(std::size_t size) { at_ += (size - (at_ - kHead) % size) % size; }
    bool reserve(std::size_t size) {
        good_ = good_ && at_ <= data_.size() && size <= data_.size() - at_;
        return good_;
    }
    template <typename T>
    T read() {
        T value{};
        if (!reserve(sizeof(T))) return value;
        char bytes[sizeof(T)];
        std::memcpy(bytes, data_.data() + at_, sizeof(T));
        at_ += sizeof(T);
        if (swapped_) {
            for (std::size_t i = 0; i < sizeof(T) / 2; ++i) std::swap(bytes[i], bytes[sizeof(T) - 1 - i]);
        }
        std::memcpy(&value, bytes, sizeof(T));
        return value;
    }

    std::string_view data_;
    std::size_t at_ = kHead;
    bool good_, swapped_ = false;
};

struct Numbers {
    std::size_t count = 0, at = 0;
};

// Where the parts of one message are; `read` is false for bytes that are no JointState.
struct JointStateParts {
    std::int64_t stamp_ns = 0;
    std::string_view frame;
    std::size_t frame_at = 0, names_at = 0, names = 0, size = 0;
    std::array<Numbers, 3> numbers;  // position, velocity, effort
    bool swapped = false;

    bool read(std::string_view data) {
        CdrCursor cursor(data);
        const auto seconds = static_cast<std::int32_t>(cursor.number());
        stamp_ns = static_cast<std::int64_t>(seconds) * 1000000000 + cursor.number();
        frame = cursor.text();
        frame_at = cursor.good() ? static_cast<std::size_t>(frame.data() - data.data()) : 0;
        names = cursor.number();
        names_at = cursor.at();
        if (names > kNamesRead) return false;
        for (std::size_t i = 0; i < names && cursor.good(); ++i) cursor.text();
        for (Numbers& each : numbers) {
            each.count = cursor.number();
            each.at = cursor.doubles(each.count);
        }
        size = cursor.at();
        swapped = cursor.swapped();
        return cursor.good();
    }

    // Calls `use(index, name)` for each joint name.
    template <typename Use>
    void each_name(std::string_view data, Use&& use) const {
        CdrCursor cursor(data);
        skip_to_names(cursor);
        for (std::size_t i = 0; i < names; ++i) use(i, cursor.text());
    }

    // The bytes that stay in every message of the same publisher: all but stamp, run id, numbers and padding.
    Layout layout(std::string_view data) const {
        Layout found;
        found.fixed.assign(size, '\0');
        found.mask.assign(size, '\0');
        found.stamp_at = 4;
        found.frame_at = frame_at;
        found.frame_length = frame.size();
        const auto keep = [&](std::size_t at, std::size_t count) {
            std::memcpy(found.fixed.data() + at, data.data() + at, count);
            std::memset(found.mask.data() + at, 0xff, count);
        };
        keep(0, 2);
        keep(frame_at - 4, 4);
        CdrCursor cursor(data);
        skip_to_names(cursor);
        keep(cursor.at() - 4, 4);
        for (std::size_t i = 0; i < names; ++i) {
            const std::string_view name = cursor.text();
            const auto at = static_cast<std::size_t>(name.data() - data.data());
            keep(at - 4, cursor.at() - at + 4);
        }
        for (const Numbers& each : numbers) {
            cursor.number();
            keep(cursor.at() - 4, 4);
            cursor.doubles(each.count);
        }
        return found;
    }

  private:
    static void skip_to_names(CdrCursor& cursor) { cursor.number(), cursor.number(), cursor.text(), cursor.number(); }
};

// Messages of another layout in the expected one, mapped by joint name: what a foreign node sends.
class Translator {
  public:
    struct Field {
        std::size_t which, at;  // 0 position, 1 velocity, 2 effort; byte offset in the expected layout
    };

    // `expected` is a whole message of the expected layout, for these joints in this order.
    Translator(std::vector<std::string> joints, std::string expected, Layout layout, std::vector<Field> fields)
        : joints_(std::move(joints)),
          bytes_(std::move(expected)),
          layout_(std::move(layout)),
          fields_(std::move(fields)),
          order_(joints_.size()) {}

    // The translated message, or an empty view: not a JointState, or a joint is missing. An array of another length
    // than the names becomes "not a number".
    std::string_view translate(std::string_view data) {
        JointStateParts parts;
        if (!parts.read(data) || !find_joints(data, parts)) return {};
        put_stamp(bytes_, layout_.stamp_at, parts.stamp_ns);
        for (std::size_t i = 0; i < layout_.frame_length; ++i) {
            const char letter = i < parts.frame.size() ? parts.frame[i] : ' ';
            bytes_[layout_.frame_at + i] = static_cast<unsigned char>(letter) < 0x80 ? letter : '?';
        }
        CdrCursor cursor(data);
        for (const Field& field : fields_) {
            const Numbers& numbers = parts.numbers[field.which];
            for (std::size_t j = 0; j < joints_.size(); ++j) {
                const double value = numbers.count == parts.names ? cursor.double_at(numbers.at + 8 * order_[j])
                                                                  : std::numeric_limits<double>::quiet_NaN();
                std::memcpy(bytes_.data() + field.at + 8 * j, &value, sizeof value);
            }
        }
        return bytes_;
    }

  private:
    bool find_joints(std::string_view data, const JointStateParts& parts) {
        constexpr auto kMissing = std::numeric_limits<std::size_t>::max();
        for (std::size_t& place : order_) place = kMissing;
        parts.each_name(data, [&](std::size_t index, std::string_view name) {
            for (std::size_t j = 0; j < joints_.size(); ++j) {
                if (order_[j] == kMissing && name == joints_[j]) order_[j] = index;
            }
        });
        for (const std::size_t place : order_) {
            if (place == kMissing) return false;
        }
        return true;
    }

    std::vector<std::string> joints_;
    std::string bytes_;
    Layout layout_;
    std::vector<Field> fields_;
    std::vector<std::size_t> order_;
};

}  // namespace hd
