// Projection function P: a bounded integrator, the update of every adapted parameter. Zhu (11), (12), (38), (40).
//
//     dP/dt = gain * drive * kappa,   kappa = 0 at a bound that the drive pushes against, else 1
//
// The discrete form below is exact for a drive that is constant over the step. It keeps, for every theta in [low, high]
// and with P the value AFTER the step, (theta - P)(drive - dP / (gain dt)) <= 0, which the stability proof needs.
#pragma once

namespace hd {

// x limited to [low, high]. A NaN becomes `low`: a bounded value stays bounded whatever comes in.
inline double clip(double x, double low, double high) { return x >= low ? (x <= high ? x : high) : low; }

// One step of P. `drive` s, `gain` rho, `value` P before the step. Returns P after the step, always inside [low, high].
// A drive that is not a number leaves the value where it is (inside its bounds).
inline double project(double value, double drive, double gain, double low, double high, double dt) {
    if ((value <= low && drive <= 0.0) || (value >= high && drive >= 0.0) || drive != drive) {
        return clip(value, low, high);
    }
    return clip(value + dt * gain * drive, low, high);
}

}  // namespace hd
