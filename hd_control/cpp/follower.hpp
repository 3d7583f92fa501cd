// The reference by tick: holds, follows one path, and may have one more that starts later; slow motion of a degraded
// robot. Paths are made outside the loop and handed over; the loop neither makes nor frees one.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "spline.hpp"

namespace hd {

// A spline of all joints from `start` on, and the state at its end; no segments: hold. `delay` moves it, once the other
// half of the knots is written: a reader outside the loop sees the old motion or the new one.
struct MotionPath {
    std::int64_t id = 0;
    int joints = 0;
    double period = 0.0;
    std::int64_t start[2] = {0, 0};
    std::vector<double> knots[2], coefficients, end;  // end: position, velocity, acceleration
    std::atomic<int> half{0};

    std::int64_t start_tick() const { return start[half.load(std::memory_order_acquire)]; }
    std::int64_t end_tick() const {
        const int h = half.load(std::memory_order_acquire);
        return start[h] + static_cast<std::int64_t>(std::ceil(knots[h].back()));
    }

    void delay(double ticks) {
        const int h = half.load(std::memory_order_relaxed), other = 1 - h;
        const double whole = std::floor(ticks);
        start[other] = start[h] + static_cast<std::int64_t>(whole);
        for (std::size_t i = 0; i < knots[h].size(); ++i) knots[other][i] = knots[h][i] + (ticks - whole);
        half.store(other, std::memory_order_release);
    }

    // Before the start the start, at the last point its values, after it its position at rest.
    std::size_t evaluate(double tick, std::size_t cursor, double* out) const {
        const int h = half.load(std::memory_order_acquire), n = joints;
        const double offset = tick - static_cast<double>(start[h]), last = knots[h].back();
        const std::size_t segments = knots[h].size() - 1;
        if (offset < last && segments > 0) {
            const Spline spline{n, segments, knots[h].data(), coefficients.data()};
            return hd::evaluate(spline, offset > 0.0 ? offset : 0.0, period, cursor, out);
        }
        for (int i = 0; i < 3 * n; ++i) out[i] = i < n || offset == last ? end[static_cast<std::size_t>(i)] : 0.0;
        return cursor;
    }

    // Standing still at `position` from `tick` on; in memory that is there.
    void hold(const double* position, std::int64_t tick) {
        start[0] = start[1] = tick;
        for (auto& each : knots) each[0] = 0.0;  // an earlier delay may have moved it
        std::fill(end.begin(), end.end(), 0.0);
        std::copy(position, position + joints, end.begin());
        half.store(0, std::memory_order_release);
    }
};

constexpr double kSlowRate = 0.25, kChangeTime = 0.2;  // share of the speed of a degraded robot; s to get there

// Rate of the path's time and how many ticks it lags behind: a degraded robot follows its path slowly, and catches
// nothing up afterwards.
struct SlowMotion {
    explicit SlowMotion(double period) : period(period), step_((1.0 - kSlowRate) * period / kChangeTime) {}

    void reset() { rate = 1.0, lag = 0.0; }
    bool at_rest() const { return rate == 1.0 && lag == 0.0; }
    void step(bool slow) {
        const double before = rate;
        rate = slow ? std::max(kSlowRate, before - step_) : std::min(1.0, before + step_);
        slope = (rate - before) / period;
        lag += 1.0 - 0.5 * (rate + before);
    }
    // Velocity and acceleration of the path (3n) become those of the reference, in place.
    void scale(double* motion, int n) const {
        for (int j = 0; j < n; ++j) {
            double &v = motion[n + j], &a = motion[2 * n + j];
            a = a * (rate * rate) + slope * v;
            v *= rate;
        }
    }

    double period, rate = 1.0, lag = 0.0, slope = 0.0;

  private:
    double step_;
};

class Follower {
  public:
    explicit Follower(int joints, double period) : n(joints), own_{path(joints, period), path(joints, period)} {}

    static std::unique_ptr<MotionPath> path(int joints, double period) {
        auto made = std::make_unique<MotionPath>();
        made->joints = joints;
        made->period = period;
        made->knots[0] = made->knots[1] = {0.0};
        made->end.assign(static_cast<std::size_t>(3 * joints), 0.0);
        return made;
    }

    bool set() const { return active.load(std::memory_order_acquire) != nullptr; }
    void forget() {
        pending.store(nullptr, std::memory_order_release);
        active.store(nullptr, std::memory_order_release);
    }

    // Stands still at `position` from `tick` on, without a blend; drops every goal.
    void hold(const double* position, std::int64_t tick) {
        MotionPath* next = own_[use_ = 1 - use_].get();
        next->hold(position, tick);
        next->id = --holds_;
        active.store(next, std::memory_order_release);
        pending.store(nullptr, std::memory_order_release);
        cursor_ = 0;
    }

    void accept(MotionPath* path, std::int64_t tick) {
        if (path->start_tick() > tick) {
            pending.store(path, std::memory_order_release);
        } else {
            active.store(path, std::memory_order_release);
            pending.store(nullptr, std::memory_order_release);
            cursor_ = 0;
        }
    }

    void delay(double ticks) {
        active.load(std::memory_order_relaxed)->delay(ticks);
        if (MotionPath* later = pending.load(std::memory_order_relaxed)) later->delay(ticks);
    }

    void sample(double tick, double* out) {
        MotionPath* later = pending.load(std::memory_order_relaxed);
        if (later != nullptr && tick >= static_cast<double>(later->start_tick())) {
            active.store(later, std::memory_order_release);
            pending.store(nullptr, std::memory_order_release);
            cursor_ = 0;
        }
        cursor_ = active.load(std::memory_order_relaxed)->evaluate(tick, cursor_, out);
    }

    bool moving(double tick) const {
        return pending.load(std::memory_order_relaxed) != nullptr ||
               tick < static_cast<double>(active.load(std::memory_order_relaxed)->end_tick());
    }

    const int n;
    std::atomic<MotionPath*> active{nullptr}, pending{nullptr};

  private:
    std::unique_ptr<MotionPath> own_[2];
    int use_ = 0;
    std::int64_t holds_ = 0;
    std::size_t cursor_ = 0;
};

}  // namespace hd
