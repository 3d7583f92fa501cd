// Monitors of the three sensors of a joint around the fusion law: F03 to F05, F07 to F10.
//
// Rows of a reading are encoder (output side, rad), resolver (rad) and gauge bridge (N m), columns are joints. Two bad
// readings in a row are bridged by the prediction; from the third on the reading becomes "not a number", which no law
// uses and every gate stops on. A jump that stays is taken over after it has stopped the robot, so that nothing is
// rejected for ever. Comparisons are written so that a NaN is never ordinary. docs/safety.md, docs/faults.md.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "fusion.hpp"
#include "guard.hpp"
#include "rigid_chain.hpp"
#include "safety.hpp"

namespace hd {

constexpr double kWholeTurn = 2.0 * 3.14159265358979323846;    // rad of the shaft over which the residual is integrated
constexpr double kLongestWay = 2.5 * 3.14159265358979323846;   // rad of the shaft within which a net turn must come
constexpr double kLargestStep = 0.3;   // rad of the shaft between two looks: 4 beta needs ten looks per period
constexpr double kStopShare = 2.0;     // residuals above their limit are reported, above this many times they stop
constexpr double kMovedCounts = 5.0;   // twist limits; less motion does not show that a gauge ought to have changed
constexpr int kRedundancyTicks = 4;    // the sensors are compared every so many ticks
constexpr double kWarmReserve = 1.0;   // s; a temperature may be ahead of its rate by what it could change in this time

class SensorWatch {
  public:
    SensorWatch(const double* guard_limits, int joints)
        : n(joints),
          memory_(guard_limits, guard_limits + GuardLimits::size(joints)),
          limits_(memory_.data(), joints),
          limit_(size(3)),
          free_(size(1)),
          moved_limit_(size(1)),
          scale_(size(3), 1.0),
          period_(size(3), 0.0),
          stiffness_(size(1), 1.0),
          reading_(size(3)),
          last_(size(3)),
          slope_(size(3)),
          raw_(size(3)),
          bad_(size(3)),
          new_slope_(size(3)),
          run_(size(2)),
          frozen_reading_(size(1)),
          frozen_repeats_(size(1)),
          frozen_start_(size(1)),
          repeats_(size(2)),
          start_(size(1)),
          stuck_reading_(size(2)),
          stuck_repeats_(size(2)),
          stuck_expected_(size(2)),
          stuck_other_(size(2)),
          expected_(size(2)),
          other_(size(2)),
          moved_(size(2)),
          positions_(size(2)),
          twist_(size(1)),
          residual_(size(1)),
          angle_(size(1)),
          terms_(size(3)),
          travel_(size(1)),
          sums_(size(4)),
          new_terms_(size(3)),
          new_travel_(size(1)),
          new_sums_(size(4)),
          step_(size(1)),
          stops_(static_cast<std::size_t>(joints)),
          warm_(size(1), NAN),
          warm_reserve_(size(1)),
          mean(size(1), NAN),
          ripple(size(1), NAN),
          missed_motion(size(1)) {
        for (int j = 0; j < n; ++j) {
            limit_[at(0, j)] = limit_[at(1, j)] = limits_.position_step_limit[j];
            limit_[at(2, j)] = limits_.gauge_step_limit[j];
            free_[at(0, j)] = kRailShare * limits_.gauge_rail[j];
            moved_limit_[at(0, j)] = kMovedCounts * limits_.twist_limit[j];
        }
    }

    void adopt(const FusionParams& params) {
        wraps_ = false;
        for (int j = 0; j < n; ++j) {
            scale_[at(0, j)] = params.gear_ratio[j];
            period_[at(0, j)] = params.encoder_period[j] / params.gear_ratio[j];
            period_[at(1, j)] = params.resolver_period[j];
            wraps_ |= period_[at(0, j)] != 0.0 || period_[at(1, j)] != 0.0;
            stiffness_[at(0, j)] = params.torsional_stiffness[j];
        }
    }

    void start() {
        screened_ = watched_ = summed_ = false;
        for (auto* each : {&mean, &ripple}) std::fill(each->begin(), each->end(), NAN);
        std::fill(run_.begin(), run_.end(), 0.0);
        std::fill(warm_.begin(), warm_.end(), NAN);
    }

    // Screens the readings of a sample in place.
    void before(FusionSample& sample, FaultRows& faults) {
        double* rows[3] = {sample.motor_shaft_position, sample.joint_position, sample.gauge_torque};
        for (int s = 0; s < 3; ++s)
            for (int j = 0; j < n; ++j) reading_[at(s, j)] = rows[s][j] / scale_[at(s, j)];
        if (!screened_) return first_screen();
        const double* period = wraps_ ? period_.data() : nullptr;
        if (readings_follow(reading_.data(), last_.data(), slope_.data(), limit_.data(), period, new_slope_.data(),
                            3 * n)) {
            last_ = reading_;
            std::swap(slope_, new_slope_);
            raw_ = reading_;
            std::fill(bad_.begin(), bad_.end(), 0.0);
            return;
        }
        for (int s = 0; s < 3; ++s)
            for (int j = 0; j < n; ++j) screen(s, j, rows[s][j], faults);
    }

    // F45: screens the motor temperatures in place. One that is no number or out of range is not used; one that changes
    // faster than a motor can is followed at the fastest rate. So a wrong one moves the gauge's correction slowly.
    void temperatures(FusionSample& sample, double dt, FaultRows& faults) {
        const double most = limits_.motor_temperature_rate[0] * kWarmReserve;
        for (int j = 0; j < n; ++j) {
            double &value = sample.motor_temperature[j], &last = warm_[at(0, j)], &reserve = warm_reserve_[at(0, j)];
            reserve = std::min(most, reserve + limits_.motor_temperature_rate[0] * dt);
            if (value == last || (std::isnan(value) && std::isnan(last))) continue;
            const double low = limits_.motor_temperature_low[0], high = limits_.motor_temperature_high[0];
            if (!(low <= value && value <= high)) {
                faults.add(kTemperatureBad, j, value, value < low ? low : high, kReport);
                value = last;
                continue;
            }
            const double change = std::isnan(last) ? 0.0 : value - last;
            if (std::fabs(change) <= reserve) {
                reserve = std::isnan(last) ? most : reserve - std::fabs(change);
            } else {
                faults.add(kTemperatureBad, j, value, last, kReport);
                value = last + std::copysign(reserve, change);
                reserve = 0.0;
            }
            last = value;
        }
    }

    // Compares the sensors with each other; withholds the joint torque where they disagree.
    void after(const FusionSample& sample, FusionOutput& out, std::int64_t tick, FaultRows& faults) {
        const int first = faults.count;
        std::fill(stops_.begin(), stops_.end(), 0);
        disagree(out.motor_position, out.resolver_position, faults);
        at_rail(sample.gauge_torque, faults);
        frozen(sample.gauge_torque, out.motor_position, faults);
        if (tick % kRedundancyTicks == 0) compare(out, faults);
        if (faults.count == first) return;
        for (int j = 0; j < n; ++j)
            if (stops_[static_cast<std::size_t>(j)]) out.joint_torque[j] = NAN;
    }

    bool compared() const { return summed_; }

  private:
    std::size_t size(int rows) const { return static_cast<std::size_t>(rows * n); }
    std::size_t at(int row, int j) const { return static_cast<std::size_t>(row * n + j); }

    void first_screen() {
        for (std::size_t i = 0; i < reading_.size(); ++i) {
            last_[i] = raw_[i] = std::isfinite(reading_[i]) ? reading_[i] : NAN;
            slope_[i] = bad_[i] = 0.0;
        }
        for (int j = 0; j < n; ++j) {
            frozen_reading_[at(0, j)] = reading_[at(2, j)];
            frozen_repeats_[at(0, j)] = 0.0;
            frozen_start_[at(0, j)] = reading_[at(0, j)];
        }
        screened_ = true;
    }

    void screen(int s, int j, double& value, FaultRows& faults) {
        const std::size_t i = at(s, j);
        const double period = wraps_ ? period_[i] : 0.0, reading = reading_[i];
        const double predicted = last_[i] + slope_[i], raw = std::isfinite(reading) ? reading : NAN;
        const double change = modular(reading - predicted, period);
        const bool good = std::fabs(change) <= limit_[i];
        const double bad = good ? 0.0 : bad_[i] + 1.0;
        const bool gone = bad >= limits_.rejected_samples[0];
        const bool stays = gone && std::fabs(modular(raw - raw_[i], period)) <= limit_[i];
        const double used = good ? raw : (gone ? NAN : predicted);
        // A bridged reading goes on with half the slope: a long gap must not run away.
        slope_[i] = good ? modular(raw - last_[i], period) : (stays ? 0.0 : 0.5 * slope_[i]);
        if (good || stays)
            last_[i] = raw;
        else if (std::isfinite(predicted))
            last_[i] = predicted;
        raw_[i] = raw;
        bad_[i] = stays ? 0.0 : bad;
        if (!good)
            faults.add(std::isfinite(reading) ? kSpike : kNotFinite, j, change, limit_[i],
                       gone ? kControlledStop : kReport);
        if (!(used == reading)) value = used * scale_[i];
    }

    // F07: motor and joint position further apart than any twist.
    void disagree(const double* motor, const double* joint, FaultRows& faults) {
        const bool near = all_near(motor, joint, limits_.twist_limit, n);
        for (int j = 0; j < n; ++j) {
            const double difference = motor[j] - joint[j];
            const bool fine = near || std::fabs(difference) <= limits_.twist_limit[j] || std::isnan(difference);
            run_[at(0, j)] = fine ? 0.0 : run_[at(0, j)] + 1.0;
            if (near || !(run_[at(0, j)] >= limits_.disagree_samples[0])) continue;
            stop(j);
            faults.add(kPositionDisagree, j, difference, limits_.twist_limit[j], kControlledStop);
        }
    }

    // F08: readings at the rail of the gauge.
    void at_rail(const double* gauge, FaultRows& faults) {
        const bool below = all_below(gauge, free_.data(), n);
        for (int j = 0; j < n; ++j) {
            const bool fine = below || std::fabs(gauge[j]) < free_[at(0, j)] || std::isnan(gauge[j]);
            double& run = run_[at(1, j)];
            run = fine ? 0.0 : run + 1.0;
            if (below || !(run > 0.0)) continue;
            const bool stops = run >= limits_.rail_samples[0];
            if (stops) stop(j);
            faults.add(kGaugeRail, j, gauge[j], limits_.gauge_rail[j], stops ? kControlledStop : kReport);
        }
    }

    // F03 for the gauge: equal readings while the motor moved by much more than a torque could hide.
    void frozen(const double* gauge, const double* position, FaultRows& faults) {
        const bool ordinary =
            gauge_changes(gauge, position, frozen_reading_.data(), frozen_repeats_.data(), frozen_start_.data(),
                          moved_limit_.data(), limits_.frozen_samples[0], repeats_.data(), start_.data(), n);
        for (int j = 0; j < n; ++j) {
            frozen_reading_[at(0, j)] = gauge[j];
            frozen_repeats_[at(0, j)] = repeats_[at(0, j)];
            frozen_start_[at(0, j)] = start_[at(0, j)];
            if (ordinary) continue;
            if (std::fabs(position[j] - start_[at(0, j)]) > moved_limit_[at(0, j)] &&
                repeats_[at(0, j)] >= limits_.frozen_samples[0]) {
                stop(j);
                faults.add(kValueFrozen, j, repeats_[at(0, j)], limits_.frozen_samples[0], kControlledStop);
            }
        }
    }

    // The relation between the three sensors, Zhu (1), and positions that do not take part in it any more.
    void compare(const FusionOutput& out, FaultRows& faults) {
        for (int j = 0; j < n; ++j) {
            const double motor = out.motor_position[j], joint = out.resolver_position[j];
            const double torque = out.joint_torque[j], error = out.kinematic_error[j], k = stiffness_[at(0, j)];
            positions_[at(0, j)] = motor;
            positions_[at(1, j)] = joint;
            twist_[at(0, j)] = torque / k - error;
            residual_[at(0, j)] = torque - k * (motor + error - joint);
        }
        stuck(faults);
        redundancy(out.motor_shaft_position, out.gauge_angle, faults);
    }

    // F03 for the positions: one repeats a reading while the others show that it ought to have moved.
    void stuck(FaultRows& faults) {
        if (!watched_) {
            for (int j = 0; j < n; ++j) {
                stuck_other_[at(0, j)] = positions_[at(1, j)];
                stuck_other_[at(1, j)] = positions_[at(0, j)];
            }
            stuck_reading_ = positions_;
            std::fill(stuck_repeats_.begin(), stuck_repeats_.end(), 0.0);
            std::fill(stuck_expected_.begin(), stuck_expected_.end(), NAN);
            watched_ = true;
        }
        const StuckMemory memory{stuck_reading_.data(), stuck_repeats_.data(), stuck_expected_.data(),
                                 stuck_other_.data()};
        const bool ordinary =
            hd::missed_motion(positions_.data(), twist_.data(), memory, limits_.frozen_samples[0],
                              limits_.stuck_motion_limit, kRedundancyTicks, repeats_.data(), expected_.data(),
                              other_.data(), moved_.data(), n);
        stuck_reading_ = positions_;
        std::swap(stuck_repeats_, repeats_);
        std::swap(stuck_expected_, expected_);
        std::swap(stuck_other_, other_);
        for (int j = 0; j < n; ++j) {
            const double a = moved_[at(0, j)], b = moved_[at(1, j)];
            missed_motion[at(0, j)] = std::isnan(a) || std::isnan(b) ? NAN : std::max(a, b);
        }
        if (ordinary) return;
        for (int s = 0; s < 2; ++s)
            for (int j = 0; j < n; ++j)
                if (moved_[at(s, j)] > limits_.stuck_motion_limit[j]) {
                    stop(j);
                    faults.add(kValueFrozen, j, stuck_repeats_[at(s, j)], limits_.frozen_samples[0], kControlledStop);
                }
    }

    // F09 and F10: torque of the gauge minus torque of the twist, integrated by trapezoids over the net way of the
    // shaft. Over whole turns kinematic error and quantisation cancel in the mean; the 2 beta part reappears when a
    // branch of the bridge is open. At standstill nothing is observed, and nothing is called healthy.
    void redundancy(const double* shaft, const double* gauge_angle, FaultRows& faults) {
        if (!summed_) {
            first_sums(shaft);
            summed_ = true;
        }
        for (int j = 0; j < n; ++j) step_[at(0, j)] = shaft[j] - angle_[at(0, j)];
        if (!(all_finite(step_.data(), n) && all_finite(residual_.data(), n))) return first_sums(shaft);
        const TurnLimits turn{kWholeTurn, kLongestWay, kLargestStep};
        const bool ordinary =
            sum_turn(residual_.data(), shaft, gauge_angle, angle_.data(), terms_.data(), sums_.data(), travel_.data(),
                     turn, new_terms_.data(), new_sums_.data(), new_travel_.data(), n);
        std::swap(terms_, new_terms_);
        std::swap(sums_, new_sums_);
        std::swap(travel_, new_travel_);
        std::copy(shaft, shaft + n, angle_.begin());
        if (!ordinary) judge_turn(faults);
    }

    void first_sums(const double* shaft) {
        std::copy(shaft, shaft + n, angle_.begin());
        std::fill(terms_.begin(), terms_.end(), NAN);
        std::fill(travel_.begin(), travel_.end(), 0.0);
        std::fill(sums_.begin(), sums_.end(), 0.0);
    }

    void judge_turn(FaultRows& faults) {
        bool* whole = whole_;
        for (int j = 0; j < n; ++j) {
            const double travel = travel_[at(0, j)];
            const bool turned = std::fabs(travel) >= kWholeTurn;
            // To and fro adds the hysteresis of every loop, fast motion steps over the ripple: the sums begin anew.
            const bool astray = (!turned && sums_[at(3, j)] > kLongestWay) ||
                                std::fabs(step_[at(0, j)]) > kLargestStep;
            whole[j] = turned && !astray;
            if (whole[j]) {
                mean[at(0, j)] = sums_[at(0, j)] / travel;
                ripple[at(0, j)] = 2.0 * std::hypot(sums_[at(1, j)], sums_[at(2, j)]) / std::fabs(travel);
            }
            if (whole[j] || astray) {
                travel_[at(0, j)] = 0.0;
                for (int row = 0; row < 4; ++row) sums_[at(row, j)] = 0.0;
            }
        }
        judge(kGaugeDrift, mean, limits_.residual_limit, whole, faults);
        judge(kGaugeBranch, ripple, limits_.ripple_limit, whole, faults);
    }

    void judge(int code, const std::vector<double>& values, const double* bounds, const bool* whole,
               FaultRows& faults) {
        for (int j = 0; j < n; ++j) {
            const double value = values[at(0, j)];
            if (!whole[j] || std::fabs(value) <= bounds[j]) continue;
            const bool report = std::fabs(value) <= kStopShare * bounds[j];
            if (!report) stop(j);
            faults.add(code, j, value, bounds[j], report ? kReport : kControlledStop);
        }
    }

    void stop(int j) { stops_[static_cast<std::size_t>(j)] = 1; }

  public:
    const int n;

  private:
    std::vector<double> memory_;
    GuardLimits limits_;
    std::vector<double> limit_, free_, moved_limit_, scale_, period_, stiffness_;
    bool wraps_ = false, screened_ = false, watched_ = false, summed_ = false;
    std::vector<double> reading_, last_, slope_, raw_, bad_, new_slope_, run_;
    std::vector<double> frozen_reading_, frozen_repeats_, frozen_start_, repeats_, start_;
    std::vector<double> stuck_reading_, stuck_repeats_, stuck_expected_, stuck_other_, expected_, other_, moved_;
    std::vector<double> positions_, twist_, residual_, angle_, terms_, travel_, sums_, new_terms_, new_travel_,
        new_sums_, step_;
    std::vector<char> stops_;
    std::vector<double> warm_, warm_reserve_;  // degC in use, K by which it may change now
    bool whole_[MAX_JOINTS] = {};

  public:
    std::vector<double> mean, ripple, missed_motion;
};

}  // namespace hd
