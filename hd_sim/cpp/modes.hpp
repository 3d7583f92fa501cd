// Friction modes of one rotor over one substep: slides, sticks, stops, or reverses inside the step.
//
// The usual projection gives a whole step one friction sign. A joint that reverses without sticking then gets a speed
// error up to 2 dt G / I* that depends on where in the step the zero falls. Modes -2 and +2 split the step at the zero.
#pragma once

namespace hd_sim {

struct Mode {
    int kind;      // +1, -1 slides; 0 sticks or stops; +2, -2 reverses to that sign
    double cross;  // fraction of the step at which the velocity reaches zero
};

// b numerator of the end velocity without friction, N m s; I_e inertia; grip dt G; e half-step viscous terms.
inline Mode classify(double b, double v, double I_e, double grip, double e_positive, double e_negative) {
    if (v > 0.0) {
        const double b_p = b - grip - e_positive * v;
        if (b_p > 0.0) return {1, 1.0};
        return {b - I_e * v + grip < 0.0 ? -2 : 0, I_e * v / (I_e * v - b_p)};
    }
    if (v < 0.0) {
        const double b_n = b + grip - e_negative * v;
        if (b_n < 0.0) return {-1, 1.0};
        return {b - I_e * v - grip > 0.0 ? 2 : 0, I_e * v / (I_e * v - b_n)};
    }
    return {b > grip ? 1 : (b < -grip ? -1 : 0), 1.0};
}

inline Mode classify_first_order(double b, double grip) { return {b > grip ? 1 : (b < -grip ? -1 : 0), 1.0}; }

struct Slope {
    double shift, divisor;  // v+ = (b + shift) / divisor in every mode but 0
};

inline Slope slope_of(const Mode& mode, double v, double I_e, double grip, double e_positive, double e_negative) {
    const double s = mode.cross;
    switch (mode.kind) {
        case 1:
            return {-grip - e_positive * v, I_e + e_positive};
        case -1:
            return {grip - e_negative * v, I_e + e_negative};
        case -2:
            return {-grip * (2.0 * s - 1.0) - e_positive * v * s, I_e + e_negative * (1.0 - s)};
        case 2:
            return {grip * (2.0 * s - 1.0) - e_negative * v * s, I_e + e_positive * (1.0 - s)};
        default:
            return {0.0, 1.0};
    }
}

inline Slope slope_first_order(const Mode& mode, double I_e, double grip, double e_positive, double e_negative) {
    if (mode.kind == 0) return {0.0, 1.0};
    return mode.kind > 0 ? Slope{-grip, I_e + 2.0 * e_positive} : Slope{grip, I_e + 2.0 * e_negative};
}

}  // namespace hd_sim
