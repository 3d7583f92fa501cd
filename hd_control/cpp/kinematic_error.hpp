// Kinematic error of the gear: KE(theta) = sum_n a_n cos(n theta) + b_n sin(n theta), n = 1 .. 4, rad at the output.
// Gandhi-Ghorbel (2). Slope and curvature are derivatives with respect to the rotor angle theta.
#pragma once

#include <cmath>

namespace hd {

constexpr int kHarmonics = 4;

struct KinematicError {
    double value = 0.0;
    double slope = 0.0;
    double curvature = 0.0;
};

// One sine and one cosine, then angle addition for the higher harmonics.
inline KinematicError kinematic_error(double angle, const double* cosine, const double* sine) {
    const double c1 = std::cos(angle), s1 = std::sin(angle);
    double c = c1, s = s1;
    KinematicError error;
    for (int i = 0; i < kHarmonics; ++i) {
        const double n = i + 1;
        const double in_phase = cosine[i] * c + sine[i] * s;
        error.value += in_phase;
        error.slope += n * (sine[i] * c - cosine[i] * s);
        error.curvature -= n * n * in_phase;
        const double next = c * c1 - s * s1;
        s = s * c1 + c * s1;
        c = next;
    }
    return error;
}

}  // namespace hd
