// Innovations of one joint: a Kalman filter of rotor, spring with damper and link, and what forces, angles and sensor
// terms do to them. Equations: docs/equations/innovations.md (K1) to (K6).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace hd::innovations {

constexpr std::size_t STATES = 4;   // rotor angle and speed, link angle and speed
constexpr std::size_t FORCES = 2;   // on the rotor, on the link
constexpr std::size_t SENSORS = 3;  // rotor angle, link angle, joint torque
constexpr std::size_t LANES = 8;    // most columns that are filtered side by side
constexpr double NOTHING = 1e-100;  // a state below it is zero: what is numerically next to nothing is slow

using Matrix = std::array<double, STATES * STATES>;
using Input = std::array<double, STATES * FORCES>;

// The linear joint over one sample: x+ = F x + G f with f held over the sample, y = C x.
struct Joint {
    double rotor_inertia, stiffness, damping, period;
    [[nodiscard]] std::array<double, SENSORS * STATES> sensors() const {
        return {1, 0, 0, 0, 0, 0, 1, 0, stiffness, damping, -stiffness, -damping};
    }
};

struct Step {
    Matrix f;
    Input g;
};

inline Matrix product(const Matrix& a, const Matrix& b) {
    Matrix c{};
    for (std::size_t i = 0; i < STATES; ++i)
        for (std::size_t k = 0; k < STATES; ++k)
            for (std::size_t j = 0; j < STATES; ++j) c[i * STATES + j] += a[i * STATES + k] * b[k * STATES + j];
    return c;
}

// exp(A T) and its integral over the sample by scaling, Taylor series and doubling: S(2h) = (I + F(h)) S(h).
inline Step step_of(const Joint& joint, double link_inertia) {
    const double k = joint.stiffness, c = joint.damping, i = joint.rotor_inertia, j = link_inertia;
    Matrix a{0, 1, 0, 0, -k / i, -c / i, k / i, c / i, 0, 0, 0, 1, k / j, c / j, -k / j, -c / j};
    double norm = 1.0;
    for (const double value : a) norm = std::max(norm, std::abs(value));
    // The rows of accelerations are large, those of speeds one: the spectral radius is near the root of the norm.
    const double radius = joint.period * std::max(std::sqrt(norm), c / i + c / j);
    int doublings = 0;
    double h = joint.period;
    for (double size = radius; size > 0.25; size *= 0.5) ++doublings, h *= 0.5;
    Matrix identity{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    Matrix power = identity, f = identity, integral{};
    for (std::size_t n = 0; n < STATES * STATES; ++n) integral[n] = identity[n] * h;
    for (int order = 1; order <= 9; ++order) {
        power = product(power, a);
        for (double& value : power) value *= h / order;
        for (std::size_t n = 0; n < STATES * STATES; ++n) {
            f[n] += power[n];
            integral[n] += power[n] * h / (order + 1);
        }
    }
    for (int n = 0; n < doublings; ++n) {
        const Matrix moved = product(f, integral);
        for (std::size_t m = 0; m < STATES * STATES; ++m) integral[m] += moved[m];
        f = product(f, f);
    }
    Step found{f, {}};
    for (std::size_t n = 0; n < STATES; ++n) {
        found.g[n * FORCES] = integral[n * STATES + 1] / i;
        found.g[n * FORCES + 1] = integral[n * STATES + 3] / j;
    }
    return found;
}

// Gains K (STATES x p) and whitening L^-1 (p x p, lower) of every sample, S = L L^T the covariance of the innovation.
struct Filter {
    std::size_t samples = 0, present = 0;
    std::array<std::size_t, SENSORS> which{};  // sensors that are measured, in order
    bool constant = true;                      // one step for all samples
    std::array<double, SENSORS * STATES> c{};
    std::vector<Step> steps;
    std::vector<double> gain, white;
    [[nodiscard]] const Step& step(std::size_t k) const { return steps[constant ? 0 : k]; }
};

struct Noise {
    const double* sensor = nullptr;        // (samples, SENSORS) variances of the sensors
    const double* force = nullptr;         // (samples, FORCES) variances of the forces
    const bool* valid = nullptr;           // (samples,) where there is a measurement
};

// One covariance step: P = F (P - K C P) F^T + G Q G^T, on the measured sensors.
inline void covariance_step(Filter& filter, std::size_t k, const Noise& noise, Matrix& p) {
    const std::size_t m = filter.present;
    const Step& step = filter.step(k);
    std::array<double, STATES * SENSORS> pc{};
    std::array<double, SENSORS * SENSORS> s{}, low{}, inverse{};
    for (std::size_t a = 0; a < m; ++a)
        for (std::size_t i = 0; i < STATES; ++i)
            for (std::size_t j = 0; j < STATES; ++j)
                pc[i * SENSORS + a] += p[i * STATES + j] * filter.c[filter.which[a] * STATES + j];
    for (std::size_t a = 0; a < m; ++a)
        for (std::size_t b = 0; b < m; ++b) {
            for (std::size_t i = 0; i < STATES; ++i)
                s[a * SENSORS + b] += filter.c[filter.which[a] * STATES + i] * pc[i * SENSORS + b];
            if (a == b) s[a * SENSORS + a] += noise.sensor[k * SENSORS + filter.which[a]];
        }
    for (std::size_t a = 0; a < m; ++a)
        for (std::size_t b = 0; b <= a; ++b) {
            double rest = s[a * SENSORS + b];
            for (std::size_t n = 0; n < b; ++n) rest -= low[a * SENSORS + n] * low[b * SENSORS + n];
            low[a * SENSORS + b] = a == b ? std::sqrt(std::max(rest, 1e-300)) : rest / low[b * SENSORS + b];
        }
    for (std::size_t b = 0; b < m; ++b) {
        inverse[b * SENSORS + b] = 1.0 / low[b * SENSORS + b];
        for (std::size_t a = b + 1; a < m; ++a) {
            double sum = 0.0;
            for (std::size_t n = b; n < a; ++n) sum += low[a * SENSORS + n] * inverse[n * SENSORS + b];
            inverse[a * SENSORS + b] = -sum / low[a * SENSORS + a];
        }
    }
    double* white = &filter.white[k * SENSORS * SENSORS];
    std::copy(inverse.begin(), inverse.end(), white);
    std::array<double, STATES * SENSORS> half{}, unit{};  // half = P C^T L^-T, unit = half L^-1 = P C^T S^-1
    const bool measured = noise.valid[k];
    if (measured) {
        for (std::size_t i = 0; i < STATES; ++i)
            for (std::size_t a = 0; a < m; ++a)
                for (std::size_t b = 0; b <= a; ++b)
                    half[i * SENSORS + a] += pc[i * SENSORS + b] * inverse[a * SENSORS + b];
        for (std::size_t i = 0; i < STATES; ++i)
            for (std::size_t b = 0; b < m; ++b)
                for (std::size_t a = b; a < m; ++a)
                    unit[i * SENSORS + b] += half[i * SENSORS + a] * inverse[a * SENSORS + b];
        for (std::size_t i = 0; i < STATES; ++i)
            for (std::size_t j = 0; j < STATES; ++j)
                for (std::size_t a = 0; a < m; ++a) p[i * STATES + j] -= half[i * SENSORS + a] * half[j * SENSORS + a];
    }
    double* gain = &filter.gain[k * STATES * SENSORS];
    std::fill(gain, gain + STATES * SENSORS, 0.0);
    for (std::size_t i = 0; i < STATES; ++i)
        for (std::size_t a = 0; a < m; ++a)
            for (std::size_t j = 0; j < STATES; ++j) gain[i * SENSORS + a] += step.f[i * STATES + j] * unit[j * SENSORS + a];
    Matrix transposed{};
    for (std::size_t i = 0; i < STATES; ++i)
        for (std::size_t j = 0; j < STATES; ++j) transposed[i * STATES + j] = step.f[j * STATES + i];
    p = product(product(step.f, p), transposed);
    for (std::size_t i = 0; i < STATES; ++i)
        for (std::size_t j = 0; j < STATES; ++j)
            for (std::size_t n = 0; n < FORCES; ++n)
                p[i * STATES + j] += step.g[i * FORCES + n] * noise.force[k * FORCES + n] * step.g[j * FORCES + n];
    for (std::size_t i = 0; i < STATES; ++i)
        for (std::size_t j = 0; j < i; ++j) p[i * STATES + j] = p[j * STATES + i] = 0.5 * (p[i * STATES + j] + p[j * STATES + i]);
}

// What drives the filter, a block of W columns: arrays (samples, W), null where there is nothing.
// Forces and the angle act over the sample that begins at k; `now` is the angle's torque at the stamp.
struct Drive {
    const double *rotor = nullptr, *link = nullptr, *spring = nullptr, *now = nullptr;
    std::array<const double*, SENSORS> sensor{};
};

// White innovations (samples, present, W) of a block: e = C z + r, z+ = F z + G f - K e. `states` (samples, 4): z of
// the first column, if wanted.
template <std::size_t W>
void respond(const Filter& filter, const Drive& drive, double* out, double* states) {
    double z[STATES][W] = {}, e[SENSORS][W], next[STATES][W], rotor[W], link[W];
    const std::size_t m = filter.present;
    for (std::size_t k = 0; k < filter.samples; ++k) {
        const Step& step = filter.step(k);
        const double* gain = &filter.gain[k * STATES * SENSORS];
        const double* white = &filter.white[k * SENSORS * SENSORS];
        if (states != nullptr)
            for (std::size_t i = 0; i < STATES; ++i) states[k * STATES + i] = z[i][0];
        for (std::size_t a = 0; a < m; ++a) {
            const std::size_t s = filter.which[a];
            const double* c = &filter.c[s * STATES];
            for (std::size_t n = 0; n < W; ++n)
                e[a][n] = c[0] * z[0][n] + c[1] * z[1][n] + c[2] * z[2][n] + c[3] * z[3][n];
            if (drive.sensor[s] != nullptr)
                for (std::size_t n = 0; n < W; ++n) e[a][n] += drive.sensor[s][k * W + n];
            if (s == 2 && drive.now != nullptr)
                for (std::size_t n = 0; n < W; ++n) e[a][n] += drive.now[k * W + n];
        }
        for (std::size_t n = 0; n < W; ++n) {
            rotor[n] = drive.rotor == nullptr ? 0.0 : drive.rotor[k * W + n];
            link[n] = drive.link == nullptr ? 0.0 : drive.link[k * W + n];
        }
        if (drive.spring != nullptr)
            for (std::size_t n = 0; n < W; ++n) {
                rotor[n] -= drive.spring[k * W + n];
                link[n] += drive.spring[k * W + n];
            }
        for (std::size_t i = 0; i < STATES; ++i) {
            const double* f = &step.f[i * STATES];
            const double* g = &step.g[i * FORCES];
            for (std::size_t n = 0; n < W; ++n)
                next[i][n] = f[0] * z[0][n] + f[1] * z[1][n] + f[2] * z[2][n] + f[3] * z[3][n] + g[0] * rotor[n] + g[1] * link[n];
            for (std::size_t a = 0; a < m; ++a)
                for (std::size_t n = 0; n < W; ++n) next[i][n] -= gain[i * SENSORS + a] * e[a][n];
        }
        for (std::size_t i = 0; i < STATES; ++i)
            for (std::size_t n = 0; n < W; ++n) z[i][n] = std::abs(next[i][n]) < NOTHING ? 0.0 : next[i][n];
        double* row = &out[k * m * W];
        for (std::size_t a = 0; a < m; ++a)
            for (std::size_t n = 0; n < W; ++n) {
                double sum = 0.0;
                for (std::size_t b = 0; b <= a; ++b) sum += white[a * SENSORS + b] * e[b][n];
                row[a * W + n] = sum;
            }
    }
}

}  // namespace hd::innovations
