// Rigid serial chain: velocities, accelerations and forces of every link, linear in 13 parameters per link.
// Zhu (33)-(37), (39). Frame j is fixed to link j, its z axis is joint axis j.
//
//     v, w        velocity of the frame's origin, angular velocity             (actual, from joint_velocity)
//     v_r, w_r    the same made from the required joint velocity
//     a, al       time derivatives of v_r and w_r in the link frame; their rotation term uses the ACTUAL joint velocity
//     g           upward base acceleration seen in the link frame
//     b           a + w x v_r + g
//
// With link parameters m, h (mass times centre of mass), K and the sums of the quadratic ones, the net wrench of (36)
// is
//
//     f = m b + al x h + w x (w_r x h)
//     n = h x b + K al + S al - (K w) x w_r + D (w x w_r)      K = diag(d - s) minus products off the diagonal
//
// where s = parameters 5-7 (sum S), products = 8-10, d = 11-13 (sum D); this is Y_L theta_L with its zeros left out.
// psi = Y_L^T (X_r - X) is the same expression read the other way.
#pragma once

#include <array>
#include <cmath>

namespace hd {

constexpr int MAX_JOINTS = 32;
constexpr int LINK_PARAMETERS = 13;

struct Vector {
    double x, y, z;
};
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Vector product(Vector a, Vector b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }

// One joint placement: R = fixed * Rz(q) maps frame j to frame j-1; origin of frame j in frame j-1.
struct Placement {
    std::array<double, 9> rotation;
    Vector origin;

    Vector to_previous(Vector u) const {
        const auto& r = rotation;
        return {r[0] * u.x + r[1] * u.y + r[2] * u.z, r[3] * u.x + r[4] * u.y + r[5] * u.z,
                r[6] * u.x + r[7] * u.y + r[8] * u.z};
    }
    Vector to_link(Vector u) const {
        const auto& r = rotation;
        return {r[0] * u.x + r[3] * u.y + r[6] * u.z, r[1] * u.x + r[4] * u.y + r[7] * u.z,
                r[2] * u.x + r[5] * u.y + r[8] * u.z};
    }
};

inline Placement place(const double* fixed, const double* origin, double angle) {
    const double c = std::cos(angle), s = std::sin(angle);
    Placement found{{}, {origin[0], origin[1], origin[2]}};
    for (int row = 0; row < 3; ++row) {
        const double* f = fixed + 3 * row;
        found.rotation[3 * row] = f[0] * c + f[1] * s;
        found.rotation[3 * row + 1] = f[1] * c - f[0] * s;
        found.rotation[3 * row + 2] = f[2];
    }
    return found;
}

struct LinkMotion {
    Vector v{0, 0, 0}, w{0, 0, 0}, v_r{0, 0, 0}, w_r{0, 0, 0}, a{0, 0, 0}, al{0, 0, 0}, g{0, 0, 0};
};

struct Wrench {
    Vector f, n;
};

// Motion of link j from that of link j-1. Zhu (33), (34) and the component-wise derivative.
inline LinkMotion next_link(const LinkMotion& before, const Placement& joint, double rate, double required_rate,
                            double required_acceleration) {
    LinkMotion link;
    link.v = joint.to_link(before.v + cross(before.w, joint.origin));
    link.w = joint.to_link(before.w);
    link.v_r = joint.to_link(before.v_r + cross(before.w_r, joint.origin));
    link.w_r = joint.to_link(before.w_r);
    link.a = joint.to_link(before.a + cross(before.al, joint.origin));
    link.al = joint.to_link(before.al);
    link.g = joint.to_link(before.g);
    link.a = link.a + rate * Vector{link.v_r.y, -link.v_r.x, 0.0};
    link.al = link.al + rate * Vector{link.w_r.y, -link.w_r.x, 0.0};
    link.w.z += rate;
    link.w_r.z += required_rate;
    link.al.z += required_acceleration;
    return link;
}

// Net wrench Y_L theta of one link. Zhu (36).
inline Wrench net_wrench(const LinkMotion& link, const double* theta) {
    const double m = theta[0];
    const Vector h{theta[1], theta[2], theta[3]}, s{theta[4], theta[5], theta[6]}, d{theta[10], theta[11], theta[12]};
    const Vector b = link.a + cross(link.w, link.v_r) + link.g;
    const auto k = [&](Vector u) {
        return product(d - s, u) - Vector{theta[7] * u.y + theta[8] * u.z, theta[7] * u.x + theta[9] * u.z,
                                          theta[8] * u.x + theta[9] * u.y};
    };
    const Vector f = m * b + cross(link.al, h) + cross(link.w, cross(link.w_r, h));
    const Vector n = cross(h, b) + k(link.al) + (s.x + s.y + s.z) * link.al - cross(k(link.w), link.w_r) +
                     (d.x + d.y + d.z) * cross(link.w, link.w_r);
    return {f, n};
}

// psi = Y_L^T (X_r - X), 13 numbers: the drive of link parameter adaptation. Zhu (37).
inline void parameter_drive(const LinkMotion& link, double* psi) {
    const Vector dv = link.v_r - link.v, dw = link.w_r - link.w;
    const Vector &w = link.w, &w_r = link.w_r, &al = link.al;
    const Vector b = link.a + cross(w, link.v_r) + link.g;
    const Vector first = cross(dv, al) + cross(cross(dv, w), w_r) + cross(b, dw);
    const Vector c = cross(w_r, dw);
    const double along = dot(al, dw), turn = dot(w, c);
    const double values[LINK_PARAMETERS] = {
        dot(b, dv),
        first.x,
        first.y,
        first.z,
        along - al.x * dw.x + w.x * c.x,
        along - al.y * dw.y + w.y * c.y,
        along - al.z * dw.z + w.z * c.z,
        w.y * c.x + w.x * c.y - al.y * dw.x - al.x * dw.y,
        w.z * c.x + w.x * c.z - al.z * dw.x - al.x * dw.z,
        w.z * c.y + w.y * c.z - al.z * dw.y - al.y * dw.z,
        al.x * dw.x - w.x * c.x + turn,
        al.y * dw.y - w.y * c.y + turn,
        al.z * dw.z - w.z * c.z + turn,
    };
    for (int i = 0; i < LINK_PARAMETERS; ++i) psi[i] = values[i];
}

// A chain as arrays: rotation 9 and origin 3 numbers per joint, 13 link parameters per joint.
struct Chain {
    int joints;
    const double* rotation;
    const double* origin;
    double gravity;
};

// Joint torques of the chain for required rates and accelerations at actual positions and rates. Zhu (36), (39), (40)
// first term. `psi` (13 per joint) may be null. With required = actual rates this is the inverse dynamics of the arm.
inline void rigid_torque(const Chain& chain, const double* theta, const double* position, const double* rate,
                         const double* required_rate, const double* required_acceleration, double* torque,
                         double* psi) {
    Placement placements[MAX_JOINTS];
    Wrench net[MAX_JOINTS];
    LinkMotion link;
    link.g = {0.0, 0.0, chain.gravity};
    for (int j = 0; j < chain.joints; ++j) {
        placements[j] = place(chain.rotation + 9 * j, chain.origin + 3 * j, position[j]);
        link = next_link(link, placements[j], rate[j], required_rate[j], required_acceleration[j]);
        net[j] = net_wrench(link, theta + LINK_PARAMETERS * j);
        if (psi != nullptr) parameter_drive(link, psi + LINK_PARAMETERS * j);
    }
    Wrench total{{0, 0, 0}, {0, 0, 0}};
    for (int j = chain.joints - 1; j >= 0; --j) {
        total = {net[j].f + total.f, net[j].n + total.n};
        torque[j] = total.n.z;
        const Vector f = placements[j].to_previous(total.f);
        total = {f, placements[j].to_previous(total.n) + cross(placements[j].origin, f)};
    }
}

}  // namespace hd
