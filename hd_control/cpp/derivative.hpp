// Derivative filter D: cutoff s / (s + cutoff). Zhu, section V; general rates by the pole's exact image.
//
//     D(x)[k] = a D(x)[k-1] + (1 - a) (x[k] - x[k-1]) / dt
//
// Rule for the pole a: the paper's own setting (dt = 1 ms, cutoff = 200 rad/s) uses its literal a = 1 - cutoff dt =
// 0.8; every other setting uses a = exp(-cutoff dt). Group delay at low frequency is a dt / (1 - a) plus half a sample.
// D squared means D applied to the output of D.
#pragma once

#include <cmath>

namespace hd {

// Pole a of the filter for `cutoff` in rad/s and sample time `dt` in s.
inline double derivative_pole(double cutoff, double dt) {
    const bool papers_own = std::fabs(dt - 1e-3) < 1e-12 && std::fabs(cutoff - 200.0) < 1e-9;
    return papers_own ? 0.8 : std::exp(-cutoff * dt);
}

// One sample of D. `last` holds x[k-1] and `rate` holds D(x)[k-1]; both are renewed. Returns D(x)[k].
// Start: last = first sample, rate = 0.
inline double differentiate(double x, double& last, double& rate, double pole, double dt) {
    rate = pole * rate + (1.0 - pole) * ((x - last) / dt);
    last = x;
    return rate;
}

}  // namespace hd
