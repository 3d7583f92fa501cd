// The sensors: encoder counts, resolver bits, gauge bridge, reported torque, temperature. Hashimoto (3)-(13).
//
// Noise is a function of (stream key, joint, tick) and has no state: a forked run sees the same noise, and a new source
// does not move the others.
#pragma once

#include "effects.hpp"

namespace hd_sim {

enum Stream { GAUGE_STREAM, RESOLVER_STREAM, JITTER_STREAM, STREAMS };

inline std::uint64_t mixed(std::uint64_t x) {  // the output function of SplitMix64
    x += 0x9e3779b97f4a7c15ULL;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
    return x ^ (x >> 31);
}

// Standard normal number (Box-Muller) for one stream, joint and tick.
inline double normal(std::uint64_t key, int joint, double tick) {
    const std::uint64_t seed =
        mixed(key ^ mixed((static_cast<std::uint64_t>(tick) << 4) + static_cast<std::uint64_t>(joint)));
    const double unit = 1.0 / 9007199254740992.0;  // 2^-53
    const double radius = static_cast<double>((mixed(seed) >> 11) + 1) * unit;
    const double angle = static_cast<double>(mixed(seed + 1) >> 11) * unit;
    double sine, cosine;
    sin_cos(TURN * angle, sine, cosine);
    return std::sqrt(-2.0 * std::log(radius)) * cosine;
}

// Nearest count; `counts` per turn, 0 leaves the angle exact.
inline double quantised(double angle, double counts) {
    if (counts == 0.0) return angle;
    const double step = TURN / counts;
    return step * std::floor(angle / step + 0.5);
}

// What the bridge indicates for a torque behind its amplifier; `beta` is the gauge angle on the flexspline.
template <int P>
double indicated(const Parameters<P>& p, const State<P>& s, int j, double torque, double beta, double time) {
    const double warm = s.temperature[0][j] - p.reference_temperature[0][j];
    double s2, c2, s4, c4;
    sin_cos(2.0 * beta + p.gauge_ripple_phase[0][j], s2, c2);
    sin_cos(4.0 * beta, s4, c4);
    return (1.0 + p.gauge_gain_error[0][j]) * (1.0 + p.gauge_gain_temperature[0][j] * warm) * torque +
           p.gauge_offset[0][j] + p.gauge_offset_temperature[0][j] * warm + p.gauge_offset_drift[0][j] * time +
           p.gauge_ripple_amplitude[0][j] * s2 + p.gauge_fourth_amplitude[0][j] * s4;
}

template <int N>
void read_sensors(const Parameters<Lanes<N>::padded>& p, const State<Lanes<N>::padded>& s, const std::uint64_t* keys,
                  const double* end_torque, int reported_slot, double time, PlantSample& out) {
    const double tick = s.tick[0][0];
    for (int j = 0; j < N; ++j) {
        double phi = s.motor_position[0][j], q = s.joint_position[0][j];
        if (p.sampling_jitter[0][j] != 0.0) {
            const double late = p.sampling_jitter[0][j] * normal(keys[JITTER_STREAM], j, tick);
            phi += late * s.motor_velocity[0][j];
            q += late * s.joint_velocity[0][j];
        }
        const double theta = p.gear_ratio[0][j] * phi;
        const double beta = theta + p.gauge_joint_turn[0][j] * q + p.gauge_mounting_angle[0][j];
        double sine, cosine;
        sin_cos(q, sine, cosine);
        double seen = q + p.eccentricity_cosine[0][j] * cosine + p.eccentricity_sine[0][j] * sine +
                      p.eccentricity_cosine[1][j] * (cosine * cosine - sine * sine) +
                      p.eccentricity_sine[1][j] * (2.0 * sine * cosine);
        if (p.resolver_noise[0][j] != 0.0) seen += p.resolver_noise[0][j] * normal(keys[RESOLVER_STREAM], j, tick);
        const double torque = p.gauge_time_constant[0][j] > 0.0 ? s.gauge_filtered[0][j] : end_torque[j];
        double gauge = indicated(p, s, j, torque, beta, time);
        if (p.gauge_noise[0][j] != 0.0) gauge += p.gauge_noise[0][j] * normal(keys[GAUGE_STREAM], j, tick);
        out.motor_shaft_position[j] = quantised(theta, p.encoder_counts[0][j]);
        out.joint_position[j] = quantised(seen, p.resolver_counts[0][j]);
        out.gauge_torque[j] = gauge;
        out.motor_torque_applied[j] = s.commands[reported_slot][j];
        out.motor_temperature[j] = s.temperature[0][j];
    }
}

}  // namespace hd_sim
