// Controller, sensors and clocks around the joint of the second world: what a recorder gets, tick by tick.
#pragma once

#include "second_world.hpp"

namespace hd_second {

enum Reading { ENCODER, RESOLVER, BRIDGE, TORQUE, TEMPERATURE, REFERENCE, READINGS };
enum Truth {
    T_PHI,
    T_PHI_RATE,
    T_Q,
    T_Q_RATE,
    T_JOINT,
    T_FRICTION,
    T_MOTOR,
    T_TORSION,
    T_BOUC_WEN,
    T_BRISTLE,
    T_SWING,
    T_SWING_RATE,
    T_SET_POINT,
    T_WARM,
    TRUTHS
};
enum Draw { D_DRIVE_CLOCK, D_JOINT_CLOCK, D_ENCODER, D_RESOLVER, D_GAUGE, D_TORQUE, D_ROTOR_PUSH, D_LINK_PUSH, DRAWS };

inline double on_grid(double x, double step) { return step > 0.0 ? step * std::nearbyint(x / step) : x; }

// The last milliseconds, substep by substep, read at any instant by linear interpolation.
class History {
  public:
    explicit History(double h) : h_(h) {}

    void add(double motor, double joint, double gauge, double torque) {
        rows_[count_++ % kRows] = {motor, joint, gauge, torque};
    }

    double at(int column, double time) const {
        const double place = std::max(0.0, time / h_);
        const long last = count_ - 1, first = std::max(0L, count_ - kRows);
        const long row = std::min(std::max(static_cast<long>(place), first), last - 1);
        const double part = std::min(std::max(place - static_cast<double>(row), 0.0), 1.0);
        const double before = rows_[row % kRows][column], after = rows_[(row + 1) % kRows][column];
        return before + part * (after - before);
    }

  private:
    static constexpr long kRows = 2048;
    double h_;
    long count_ = 0;
    std::array<std::array<double, 4>, kRows> rows_{};
};

// Position and velocity loops on the rotor encoder, with the integral of the position error.
class Controller {
  public:
    Controller(const Params& p, double period) : p_(p), period_(period) {}

    void start(double motor, double torque) { before_ = motor, sum_ = torque; }

    double torque(double motor, double wanted, double wanted_rate, double feed) {
        rate_ += (1.0 - std::exp(-p_.velocity_cutoff * period_)) * ((motor - before_) / period_ - rate_);
        before_ = motor;
        const double error = wanted - motor,
                     command = feed + p_.velocity_gain * (wanted_rate + p_.position_gain * error - rate_) + sum_;
        const double bounded = std::min(std::max(command, -p_.torque_limit), p_.torque_limit);
        if (bounded == command) sum_ += p_.integral_gain * error * period_;
        return bounded;
    }

  private:
    const Params& p_;
    double period_, before_ = 0.0, rate_ = 0.0, sum_ = 0.0;
};

class Recorder {
  public:
    Recorder(const Params& params, Windows windows, double period, int substeps)
        : joint_(params, std::move(windows)),
          p_(joint_.params()),
          period_(period),
          substeps_(substeps),
          loop_(p_.torque_at_stamp > 0.5 ? substeps / 4 : substeps),
          h_(period / substeps),
          history_(h_),
          controller_(p_, loop_ * h_),
          delayed_(static_cast<std::size_t>(std::lround(p_.transport_delay / h_)) + 1) {}

    // Runs n ticks of the reference; readings (n, READINGS), truths (n, TRUTHS), draws (n, DRAWS) standard normal.
    void run(int n, const double* position, const double* rate, const double* draws, double* readings, double* truths) {
        joint_.rest(position[0]);
        start(position[0]);
        for (int k = 0; k < n; ++k) {
            const int next = std::min(k + 1, n - 1);
            note(truths + static_cast<long>(k) * TRUTHS);
            double* row = readings + static_cast<long>(k) * READINGS;
            const double* draw = draws + static_cast<long>(k) * DRAWS;
            const Push push{p_.torque_disturbance * draw[D_ROTOR_PUSH], p_.link_disturbance * draw[D_LINK_PUSH]};
            row[REFERENCE] = position[k];
            row[TEMPERATURE] = joint_.state()[WARM];
            for (int i = 0; i < substeps_; ++i) {
                if (i % loop_ == 0) control(position, rate, k, next, static_cast<double>(i) / substeps_);
                if (i == 0) held_ = set_point_;
                substep(push);
            }
            read(k, draw, row);
        }
    }

  private:
    void start(double angle) {
        const double load = joint_.gravity(angle);
        controller_.start(joint_.state()[PHI], load - p_.feed_gravity * std::sin(angle - p_.gravity_angle));
        set_point_ = next_ = reported_ = load;
        std::fill(delayed_.begin(), delayed_.end(), load);
        remember();
    }

    // The torque computed from this reading acts one period of the loop later.
    void control(const double* position, const double* rate, int k, int next, double part) {
        set_point_ = next_;
        const double motor = on_grid(p_.gear_ratio * joint_.state()[PHI], p_.encoder_step) / p_.gear_ratio;
        const double wanted = position[k] + part * (position[next] - position[k]);
        const double speed = rate[k] + part * (rate[next] - rate[k]);
        next_ = controller_.torque(motor, wanted, speed, p_.feed_gravity * std::sin(wanted - p_.gravity_angle));
    }

    void substep(const Push& push) {
        delayed_[place_] = set_point_;
        place_ = (place_ + 1) % delayed_.size();
        joint_.step(h_, delayed_[place_], push);  // the oldest
        reported_ += (1.0 - std::exp(-h_ / p_.current_lag)) * (set_point_ - reported_);
        remember();
    }

    void remember() { history_.add(joint_.state()[PHI], joint_.state()[Q], joint_.state()[GAUGE], reported_); }

    void note(double* to) const {
        Torques t;
        const State& s = joint_.state();
        joint_.rates(s, joint_.time(), set_point_, {}, t);
        to[T_PHI] = s[PHI], to[T_PHI_RATE] = s[PHI_RATE], to[T_Q] = s[Q], to[T_Q_RATE] = s[Q_RATE];
        to[T_JOINT] = t.joint, to[T_FRICTION] = t.friction, to[T_MOTOR] = t.motor, to[T_TORSION] = t.torsion;
        to[T_BOUC_WEN] = s[BOUC_WEN], to[T_BRISTLE] = s[BRISTLE], to[T_SWING] = s[SWING];
        to[T_SWING_RATE] = s[SWING_RATE], to[T_SET_POINT] = set_point_, to[T_WARM] = s[WARM];
    }

    void read(int k, const double* draw, double* row) const {
        const double now = k * period_;
        const double drive = now + jitter(draw[D_DRIVE_CLOCK]);
        const double joint = now * (1.0 + p_.clock_drift) + jitter(draw[D_JOINT_CLOCK]);
        const double theta = p_.gear_ratio * history_.at(0, drive - p_.encoder_late);
        row[ENCODER] = on_grid(theta + p_.encoder_noise * draw[D_ENCODER], p_.encoder_step);
        const double q = history_.at(1, joint - p_.resolver_late);
        row[RESOLVER] = on_grid(q + disc(q) + p_.resolver_noise * draw[D_RESOLVER], p_.resolver_step);
        row[BRIDGE] =
            on_grid(bridge(joint - p_.gauge_late, row[TEMPERATURE]) + p_.gauge_noise * draw[D_GAUGE], p_.gauge_step);
        const double torque = p_.torque_at_stamp > 0.5 ? history_.at(3, drive - p_.torque_late) : held_;
        row[TORQUE] = on_grid(torque + p_.torque_noise * draw[D_TORQUE], p_.torque_step);
    }

    double jitter(double draw) const { return p_.jitter * std::min(std::max(draw, -4.0), 4.0); }

    // Reading error of an eccentric, slightly elliptic disc at a joint angle; exact geometry for the former.
    double disc(double q) const {
        const double a = q - p_.eccentricity_angle;
        const double error = std::atan2(p_.eccentricity * std::sin(a), 1.0 + p_.eccentricity * std::cos(a));
        return error + p_.ellipticity * std::sin(2.0 * (q - p_.ellipticity_angle));
    }

    double bridge(double time, double warm) const {
        const double beta = p_.gear_ratio * history_.at(0, time) - p_.gauge_turns * history_.at(1, time);
        double torque = (1.0 + p_.gauge_gain) * history_.at(2, time) + p_.gauge_offset;
        torque += p_.gauge_drift * (warm - p_.ambient_temperature);
        torque += p_.gauge_cosine_2 * std::cos(2.0 * beta) + p_.gauge_sine_2 * std::sin(2.0 * beta);
        return torque + p_.gauge_cosine_4 * std::cos(4.0 * beta) + p_.gauge_sine_4 * std::sin(4.0 * beta);
    }

    Joint joint_;
    const Params& p_;
    double period_;
    int substeps_, loop_;
    double h_;
    History history_;
    Controller controller_;
    std::vector<double> delayed_;
    std::size_t place_ = 0;
    double set_point_ = 0.0, next_ = 0.0, held_ = 0.0, reported_ = 0.0;
};

}  // namespace hd_second
