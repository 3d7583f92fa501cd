// A change of parameters while a law runs: parameters and start values go over to the new ones without a jump.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace hd {

constexpr double kRampTime = 0.5;  // s from the old model to the new one
constexpr double kGainTime = 0.1;  // s from old gains and bounds to new ones

// How each number of a parameter block changes while the law runs, and which numbers of the state follow.
struct RampPlan {
    std::vector<char> kind;                      // by number of the block: 0 at once, 1 gain, 2 model
    std::vector<std::pair<int, int>> starts;     // number of the state, number of the parameters it starts at
};

// Parameters of one law: the newest block, and the way to it, tick by tick. `offer` may be called by any thread, one
// at a time; `take` belongs to the loop.
class Parameters {
  public:
    Parameters(std::size_t size, RampPlan plan, double dt)
        : now(size), plan_(std::move(plan)), before_(size), after_(size), moves_(plan_.starts.size()), dt_(dt) {
        for (auto& each : inbox_) each.resize(size);
        plan_.kind.resize(size, 0);
    }

    // A new block. A block that was offered and not taken yet is replaced. Block number c lies in slot c % 2.
    void offer(const double* block) {
        const std::uint64_t count = count_.load(std::memory_order_relaxed) + 1;
        std::copy(block, block + now.size(), inbox_[count % 2].begin());
        count_.store(count, std::memory_order_release);
    }

    // The newest block as a whole, without a ramp.
    void arrive() {
        if (count_.load(std::memory_order_acquire) > 0) {
            copy_newest();
            now = after_;
        }
        ticks_ = tick_ = 0;
    }

    // The law goes on from the numbers that it has: what was offered meanwhile ramps from here.
    void go_on() {
        taken_ = 0;
        ticks_ = tick_ = 0;
    }

    bool changes() const { return taken_ != count_.load(std::memory_order_acquire) || tick_ < ticks_; }

    // Before the law's step: the next numbers on the way to the newest. `state` null: the law has none yet.
    // True if the block is another one than in the tick before.
    bool take(double* state) {
        bool changed = false;
        if (count_.load(std::memory_order_acquire) != taken_) {
            copy_newest();
            if (state == nullptr || !plan_ramp(state)) {
                now = after_;
                ticks_ = tick_ = 0;
            }
            changed = true;
        }
        if (tick_ < ticks_ && state != nullptr) {
            step_ramp(state);
            changed = true;
        }
        return changed;
    }

    // The numbers at the end of the way.
    std::vector<double>& goal() { return after_; }

    std::vector<double> now;

  private:
    // The slot that is read is written again only by the second offer after it: a block is whole if none came meanwhile.
    void copy_newest() {
        do {
            taken_ = count_.load(std::memory_order_acquire);
            const std::vector<double>& wanted = inbox_[taken_ % 2];
            std::copy(wanted.begin(), wanted.end(), after_.begin());
            std::atomic_thread_fence(std::memory_order_acquire);
        } while (count_.load(std::memory_order_relaxed) != taken_);
    }

    bool plan_ramp(const double* state) {
        const int model = std::max(1, static_cast<int>(std::nearbyint(kRampTime / dt_)));
        gain_ticks_ = std::max(1, static_cast<int>(std::nearbyint(kGainTime / dt_)));
        model_ticks_ = model;
        int longest = 0;
        for (std::size_t i = 0; i < now.size(); ++i)
            if (plan_.kind[i] != 0 && !(now[i] == after_[i] || (std::isnan(now[i]) && std::isnan(after_[i]))))
                longest = std::max(longest, plan_.kind[i] == 2 ? model : gain_ticks_);
        if (longest == 0) return false;
        bool moves = false;
        for (std::size_t i = 0; i < plan_.starts.size(); ++i) {
            const auto [own, source] = plan_.starts[i];
            const double goal = after_[static_cast<std::size_t>(source)];
            const double change = goal != now[static_cast<std::size_t>(source)] ? goal - state[own] : 0.0;
            moves_[i] = change / model;
            moves |= change != 0.0;
        }
        moving_ = moves;
        before_ = now;
        tick_ = 0;
        ticks_ = moves ? model : longest;
        return true;
    }

    void step_ramp(double* state) {
        ++tick_;
        if (moving_)
            for (std::size_t i = 0; i < plan_.starts.size(); ++i) state[plan_.starts[i].first] += moves_[i];
        if (tick_ >= ticks_) {
            now = after_;
            return;
        }
        for (std::size_t i = 0; i < now.size(); ++i) {
            const int ticks = plan_.kind[i] == 2 ? model_ticks_ : gain_ticks_;
            const bool there = plan_.kind[i] == 0 || tick_ >= ticks || before_[i] == after_[i];
            now[i] = there ? after_[i]
                           : before_[i] + (static_cast<double>(tick_) / ticks) * (after_[i] - before_[i]);
        }
    }

    RampPlan plan_;
    std::vector<double> inbox_[2], before_, after_, moves_;
    std::atomic<std::uint64_t> count_{0};
    std::uint64_t taken_ = 0;
    double dt_;
    int tick_ = 0, ticks_ = 0, model_ticks_ = 1, gain_ticks_ = 1;
    bool moving_ = false;
};

}  // namespace hd
