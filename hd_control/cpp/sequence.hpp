// A fixed list of what happens in one tick: copies between blocks, ticks of stages, records of numbers. It is the whole
// robot of a run without ROS, the chain of the process `chain`, and the part of it that one node holds.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "step.hpp"

namespace hd {

class Sequence {
  public:
    // `count` numbers from one block to another.
    void copy(const double* from, double* to, std::size_t count) { parts_.push_back({kCopy, {}, from, to, count, 1}); }

    // `count` numbers become the tick: the inputs that they stand for are of this tick.
    void stamp(double* ticks, std::size_t count) { parts_.push_back({kStamp, {}, nullptr, ticks, count, 1}); }

    void call(Step step) { parts_.push_back({kCall, step, nullptr, nullptr, 0, 1}); }

    // One row of `count` numbers per tick, into a table that the caller keeps; `row` counts from 0 with each `run`.
    void record(const double* from, double* table, std::size_t count) {
        parts_.push_back({kRecord, {}, from, table, count, 1});
    }

    // The part added last happens every so many ticks only: where tick % every is 0.
    void every(std::int64_t every) { parts_.back().every = every; }

    void operator()(std::int64_t tick) { one(tick, 0); }

    // Ticks first, first + 1, ... until `count` or until `*stop` is not 0 after a tick; returns how many were run.
    std::size_t run(std::int64_t first, std::size_t count, const double* stop) {
        for (std::size_t k = 0; k < count; ++k) {
            one(first + static_cast<std::int64_t>(k), k);
            if (stop != nullptr && *stop != 0.0) return k + 1;
        }
        return count;
    }

    static void run_one(void* self, std::int64_t tick) { (*static_cast<Sequence*>(self))(tick); }

  private:
    enum Kind { kCopy, kCall, kRecord, kStamp };
    struct Part {
        Kind kind;
        Step step;
        const double* from;
        double* to;
        std::size_t count;
        std::int64_t every;
    };

    void one(std::int64_t tick, std::size_t row) {
        for (const Part& part : parts_) {
            if (part.every != 1 && tick % part.every != 0) continue;
            if (part.kind == kCall)
                part.step(tick);
            else if (part.kind == kStamp)
                std::fill_n(part.to, part.count, static_cast<double>(tick));
            else
                std::copy(part.from, part.from + part.count, part.kind == kCopy ? part.to : part.to + row * part.count);
        }
    }

    std::vector<Part> parts_;
};

}  // namespace hd
