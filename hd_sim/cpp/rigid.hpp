// Rigid-body dynamics of a serial arm of revolute joints on a fixed base: M(q), bias, and (M + diag(a)) qdd = torque -
// bias.
//
// All vectors have world axes but belong to the origin of their own joint, so moving a quantity to the parent costs one
// cross product and no rotation, and nothing cancels over long lever arms. M comes from composite bodies, the bias
// from one Newton-Euler pass, the solution from an LDL^T factorisation that starts at the tip. M and bias do not depend
// on the friction modes of the drives: a repeated link solve costs only the factorisation.
#pragma once

#include "lanes.hpp"

namespace hd_sim {

struct Vec3 {
    double x, y, z;
};

inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator*(double s, const Vec3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

struct Mat3 {  // three columns
    Vec3 x, y, z;
};

inline Vec3 operator*(const Mat3& m, const Vec3& v) { return v.x * m.x + (v.y * m.y + v.z * m.z); }

struct Sym3 {
    double xx, yy, zz, xy, xz, yz;
};

inline Vec3 operator*(const Sym3& s, const Vec3& v) {
    return {s.xx * v.x + s.xy * v.y + s.xz * v.z, s.xy * v.x + s.yy * v.y + s.yz * v.z,
            s.xz * v.x + s.yz * v.y + s.zz * v.z};
}

// R S R^T
inline Sym3 rotated(const Mat3& r, const Sym3& s) {
    const Vec3 a = s.xx * r.x + (s.xy * r.y + s.xz * r.z);
    const Vec3 b = s.xy * r.x + (s.yy * r.y + s.yz * r.z);
    const Vec3 c = s.xz * r.x + (s.yz * r.y + s.zz * r.z);
    return {a.x * r.x.x + b.x * r.y.x + c.x * r.z.x, a.y * r.x.y + b.y * r.y.y + c.y * r.z.y,
            a.z * r.x.z + b.z * r.y.z + c.z * r.z.z, a.x * r.x.y + b.x * r.y.y + c.x * r.z.y,
            a.x * r.x.z + b.x * r.y.z + c.x * r.z.z, a.y * r.x.z + b.y * r.y.z + c.y * r.z.z};
}

// One link in its own frame: z is the joint axis, `about_origin` the inertia about the frame's origin.
struct Link {
    Mat3 rotation;
    Vec3 origin;
    double mass;
    Vec3 moment;  // mass times centre of mass, kg m
    Sym3 about_origin;
};

template <int N>
struct Arm {
    Link links[N];
    Vec3 base_acceleration;  // minus gravity, m/s^2
    double inertia[N][N];    // M(q), lower triangle, row >= column
    double bias[N];          // b(q, w) with gravity, N m

    // Fills `inertia` and `bias` at the given pose and velocity.
    void update(const double* sine, const double* cosine, const double* velocity) {
        Vec3 axis[N], offset[N], force[N], couple[N], moment[N];
        Sym3 about[N];
        Mat3 frame{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
        Vec3 spin{0, 0, 0}, turn{0, 0, 0}, rise = base_acceleration;
        for (int i = 0; i < N; ++i) {
            const Link& link = links[i];
            const Vec3 p = frame * link.origin;
            const Vec3 t = frame * link.rotation.x, u = frame * link.rotation.y, z = frame * link.rotation.z;
            frame = {cosine[i] * t + sine[i] * u, cosine[i] * u + (-sine[i]) * t, z};
            rise = rise + (cross(turn, p) + cross(spin, cross(spin, p)));
            turn = turn + velocity[i] * cross(spin, z);
            spin = spin + velocity[i] * z;
            const Vec3 h = frame * link.moment;
            const Sym3 j = rotated(frame, link.about_origin);
            force[i] = link.mass * rise + (cross(turn, h) + cross(spin, cross(spin, h)));
            couple[i] = (j * turn + cross(spin, j * spin)) + cross(h, rise);
            axis[i] = z;
            offset[i] = p;
            moment[i] = h;
            about[i] = j;
        }
        gather(axis, offset, force, couple, moment, about);
    }

    // From the tip to the base: bias torques, composite bodies and the columns of M.
    void gather(const Vec3* axis, const Vec3* offset, Vec3* force, Vec3* couple, Vec3* moment, Sym3* about) {
        double mass = 0.0;
        Vec3 h{0, 0, 0};
        Sym3 j{0, 0, 0, 0, 0, 0};
        for (int i = N - 1; i >= 0; --i) {
            mass += links[i].mass;
            h = h + moment[i];
            const Sym3& own = about[i];
            j = {j.xx + own.xx, j.yy + own.yy, j.zz + own.zz, j.xy + own.xy, j.xz + own.xz, j.yz + own.yz};
            bias[i] = dot(axis[i], couple[i]);
            const Vec3 push = cross(axis[i], h);
            Vec3 twist = j * axis[i];
            inertia[i][i] = dot(axis[i], twist);
            for (int k = i - 1; k >= 0; --k) {
                twist = twist + cross(offset[k + 1], push);
                inertia[i][k] = dot(axis[k], twist);
            }
            if (i == 0) break;
            const Vec3& p = offset[i];
            force[i - 1] = force[i - 1] + force[i];
            couple[i - 1] = couple[i - 1] + (couple[i] + cross(p, force[i]));
            const Vec3 s = 0.5 * (mass * p) + h;  // p h^T + h p^T + m p p^T = p s^T + s p^T
            const double around = 2.0 * dot(p, s);
            j = {j.xx + (around - 2.0 * p.x * s.x), j.yy + (around - 2.0 * p.y * s.y),
                 j.zz + (around - 2.0 * p.z * s.z), j.xy - (p.x * s.y + p.y * s.x),
                 j.xz - (p.x * s.z + p.z * s.x),    j.yz - (p.y * s.z + p.z * s.y)};
            h = h + mass * p;
        }
    }

    // acceleration = (M + diag(armature))^-1 (torque - bias), with M and bias of the last update.
    void solve(const double* torque, const double* armature, double* acceleration) const {
        double a[N][N], x[N], inverse[N];
        for (int i = 0; i < N; ++i) {
            for (int k = 0; k < i; ++k) a[i][k] = inertia[i][k];
            a[i][i] = inertia[i][i] + armature[i];
            x[i] = torque[i] - bias[i];
        }
        for (int i = N - 1; i >= 0; --i) {  // eliminate joint i from all joints before it
            inverse[i] = 1.0 / a[i][i];
            for (int k = 0; k < i; ++k) {
                const double factor = a[i][k] * inverse[i];
                for (int m = 0; m <= k; ++m) a[k][m] -= factor * a[i][m];
                x[k] -= factor * x[i];
            }
        }
        for (int i = 0; i < N; ++i) {
            double sum = x[i];
            for (int k = 0; k < i; ++k) sum -= a[i][k] * acceleration[k];
            acceleration[i] = sum * inverse[i];
        }
    }
};

}  // namespace hd_sim
