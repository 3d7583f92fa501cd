// Faults as numbers: rows of a fixed table, merged counts, and the ring that keeps what happened before a stop.
//
// The loop writes, anybody may read: a reader that meets a row half written sees one old number, never a wrong count.
// Texts are made in Python (hd_control/core/faults.py); the numbers of codes and actions are those of FaultCode, Action.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace hd {

enum Code {
    kFrameLost = 1,
    kStampStuck = 2,
    kValueFrozen = 3,
    kNotFinite = 4,
    kSpike = 5,
    kPositionDisagree = 7,
    kGaugeRail = 8,
    kGaugeBranch = 9,
    kGaugeDrift = 10,
    kNodeKilled = 18,
    kException = 33,
    kAdaptation = 34,
    kTorqueLimited = 37,
    kRateLimited = 38,
    kRatePersistent = 39,
    kEnvelope = 40,
    kLetGo = 41,
    kStopLeft = 42,
    kOverspeed = 43,
    kStampAhead = 44,
    kTemperatureBad = 45,
    kBrakeHeld = 46,
    kSlipped = 47,
    kNotObeyed = 48
};
constexpr int kCodes = 64;
enum Action { kRefuse = 0, kReport = 1, kDegrade = 2, kControlledStop = 3, kTorqueRamp = 4 };
constexpr int kFaultFields = 5;  // code, joint (-1: none), value, limit, action

inline const double kExceptionRow[kFaultFields] = {kException, -1.0, 1.0, 0.0, kTorqueRamp};
inline const double kUnknownStop[kFaultFields] = {kStopLeft, -1.0, NAN, NAN, kTorqueRamp};  // nobody has kept its fault

// Rows of one sample in memory of the caller. What does not fit is dropped: the first findings are the causes.
struct FaultRows {
    double* rows = nullptr;
    int capacity = 0;
    int count = 0;

    void add(int code, int joint, double value, double limit, int action) {
        if (count >= capacity) return;
        double* row = rows + kFaultFields * count++;
        row[0] = code;
        row[1] = joint;
        row[2] = value;
        row[3] = limit;
        row[4] = action;
    }
    const double* row(int i) const { return rows + kFaultFields * i; }
    int code(int i) const { return static_cast<int>(row(i)[0]); }
    int joint(int i) const { return static_cast<int>(row(i)[1]); }
    int action(int i) const { return static_cast<int>(row(i)[4]); }
    void set_action(int i, int action) { rows[kFaultFields * i + 4] = action; }
    void copy(const FaultRows& from, int i) {
        const double* r = from.row(i);
        add(static_cast<int>(r[0]), static_cast<int>(r[1]), r[2], r[3], static_cast<int>(r[4]));
    }
    int strongest(int first = 0) const {
        int found = kRefuse;
        for (int i = first; i < count; ++i) found = std::max(found, action(i));
        return found;
    }
    int first_with(int wanted) const {
        for (int i = 0; i < count; ++i)
            if (action(i) == wanted) return i;
        return -1;
    }
    int first_at_least(int wanted) const {
        for (int i = 0; i < count; ++i)
            if (action(i) >= wanted) return i;
        return -1;
    }
    bool has(int wanted, int joint_, int among) const {
        for (int i = 0; i < among; ++i)
            if (code(i) == wanted && joint(i) == joint_) return true;
        return false;
    }
};

// Rows with memory of their own.
struct OwnRows : FaultRows {
    explicit OwnRows(int capacity_) : memory(static_cast<std::size_t>(kFaultFields * capacity_)) {
        rows = memory.data();
        capacity = capacity_;
    }
    std::vector<double> memory;
};

// What a loop has found, merged by code and joint: how often, since which tick, the first numbers; and the first that
// stops.
class FaultTable {
  public:
    static constexpr int kFields = 6;  // count, first tick, value, limit, action, order of appearance

    explicit FaultTable(int joints)
        : joints(joints), entries(static_cast<std::size_t>(kCodes * (joints + 1) * kFields), 0.0), stop(kFaultFields) {
        clear();
    }

    void note(const FaultRows& found, double tick) {
        for (int i = 0; i < found.count; ++i) {
            double* entry = at(found.code(i), found.joint(i));
            if (entry == nullptr) continue;
            const double* row = found.row(i);
            if (entry[0] == 0.0) {
                entry[1] = tick, entry[2] = row[2], entry[3] = row[3], entry[4] = row[4], entry[5] = ++seen_;
            }
            entry[0] += 1.0;
            if (stop_tick < 0.0 && row[4] >= kControlledStop) {
                std::copy(row, row + kFaultFields, stop.begin());
                stop_tick = tick;
            }
        }
    }

    void clear() {
        std::fill(entries.begin(), entries.end(), 0.0);
        stop_tick = -1.0;
        seen_ = 0.0;
    }

    int joints;
    std::vector<double> entries, stop;
    double stop_tick = -1.0;

  private:
    double* at(int code, int joint) {
        if (code < 0 || code >= kCodes || joint < -1 || joint >= joints) return nullptr;
        return entries.data() + kFields * (code * (joints + 1) + joint + 1);
    }
    double seen_ = 0.0;
};

// Ring of rows of a loop: tick and every watched number. Twice the span of an incident, so that a reader has seconds.
class RowRing {
  public:
    explicit RowRing(std::size_t rows) : rows(rows), data(rows, 0.0) {}

    void watch(const double* numbers, std::size_t count) {
        sources_.push_back({numbers, count});
        width += count;
        data.assign(rows * width, 0.0);
    }

    // One row. `cause`: the row of the fault by which the robot is stopped, null while it is not; where the rows before
    // had none, this is the row of a new stop.
    void note(double tick, const double* cause) {
        const std::uint64_t now = written.load(std::memory_order_relaxed);
        double* row = data.data() + (now % rows) * width;
        row[0] = tick;
        double* to = row + 1;
        for (const auto& [from, count] : sources_) to = std::copy(from, from + count, to);
        written.store(now + 1, std::memory_order_release);
        if (cause != nullptr && !stopped_) {
            const std::size_t slot = stops.load(std::memory_order_relaxed) % kStops;
            stop_rows[slot] = static_cast<double>(now);
            std::copy(cause, cause + kFaultFields, causes.begin() + static_cast<std::ptrdiff_t>(slot * kFaultFields));
            stops.fetch_add(1, std::memory_order_release);
        }
        stopped_ = cause != nullptr;
    }

    static constexpr std::size_t kStops = 16;  // stops that may wait until somebody looks
    const std::size_t rows;
    std::size_t width = 1;
    std::vector<double> data;
    std::vector<double> stop_rows = std::vector<double>(kStops), causes = std::vector<double>(kStops* kFaultFields);
    std::atomic<std::uint64_t> written{0}, stops{0};

  private:
    struct Source {
        const double* numbers;
        std::size_t count;
    };
    std::vector<Source> sources_;
    bool stopped_ = false;
};

}  // namespace hd
