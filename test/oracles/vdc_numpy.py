"""The motion laws again, slow and obvious: explicit matrices and the 6 x 13 regressor, column by column.

Shares no code with the package. Zhu (31)-(40); 6-vectors are [linear; angular] in the link frame.
"""

from __future__ import annotations

import math

import numpy as np

UNIT = np.eye(3)


def hat(u):
    """Cross-product matrix: hat(u) w = u x w."""
    return np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])


def turn_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def link_motions(rotation, origin, q, dq, dqr, ddqr, gravity=9.81):
    """Per link: (X, X_r, dX_r, g, R, p); Zhu (33), (34) and the component-wise derivative of X_r."""
    v, w, vr, wr, a, al = (np.zeros(3) for _ in range(6))
    g = np.array([0, 0, gravity])
    z = UNIT[2]
    found = []
    for j in range(len(q)):
        R, p = rotation[j] @ turn_z(q[j]), origin[j]
        v, w0 = R.T @ (v + np.cross(w, p)), R.T @ w
        vr, wr0 = R.T @ (vr + np.cross(wr, p)), R.T @ wr
        a = R.T @ (a + np.cross(al, p)) - dq[j] * np.cross(z, vr)
        al = R.T @ al - dq[j] * np.cross(z, wr0) + z * ddqr[j]
        w, wr, g = w0 + z * dq[j], wr0 + z * dqr[j], R.T @ g
        found.append((np.r_[v, w], np.r_[vr, wr], np.r_[a, al], g, R, p))
    return found


def regressor(X, Xr, dXr, g):
    """Y_L (6, 13), column by column: docs/equations/motion_law.md (M6)."""
    w, vr, wr, a, al = X[3:], Xr[:3], Xr[3:], dXr[:3], dXr[3:]
    beta = a + np.cross(w, vr) + g
    Y = np.zeros((6, 13))
    Y[:3, 0] = beta
    for i in range(3):
        e = UNIT[i]
        Y[:3, 1 + i] = np.cross(al, e) + np.cross(w, np.cross(wr, e))
        Y[3:, 1 + i] = np.cross(e, beta)
        Y[3:, 4 + i] = al - e * al[i] + np.cross(e * w[i], wr)
        Y[3:, 10 + i] = e * al[i] - np.cross(e * w[i], wr) + np.cross(w, wr)
    for column, (i, k) in zip((7, 8, 9), ((0, 1), (0, 2), (1, 2)), strict=True):
        E = np.outer(UNIT[i], UNIT[k]) + np.outer(UNIT[k], UNIT[i])
        Y[3:, column] = -E @ al + np.cross(E @ w, wr)
    return Y


def explicit_matrices(m, r, inertia, w, g):
    """M (6, 6), C (6, 6), G (6,) of one link: M dX + C X + G = F."""
    S, W = hat(r), hat(w)
    M = np.block([[m * np.eye(3), -m * S], [m * S, inertia - m * S @ S]])
    C = np.block([[m * W, -m * W @ S], [m * S @ W, W @ inertia + inertia @ W - m * S @ W @ S]])
    return M, C, m * np.r_[g, np.cross(r, g)]


def torques(motions, wrenches):
    """Moments about the joint axes from the net wrenches. Zhu (39)."""
    tau, F = np.zeros(len(motions)), np.zeros(6)
    for j in reversed(range(len(motions))):
        F = wrenches[j] + F
        tau[j] = F[5]
        R, p = motions[j][4:]
        f, n = R @ F[:3], R @ F[3:]
        F = np.r_[f, n + np.cross(p, f)]
    return tau


def project(value, drive, gain, low, high, dt):
    if (value <= low and drive <= 0) or (value >= high and drive >= 0):
        return min(max(value, low), high)
    return min(max(value + dt * gain * drive, low), high)


class NumpyMotion:
    """One law with its memory. `p`: dict of parameters (n, ...) named as the block's fields."""

    def __init__(self, p, law, error_filter):
        self.p, self.law, self.error_filter = p, law, error_filter
        self.theta = np.array(p["link_parameters"])
        self.n = len(self.theta)
        self.integral, self.rate, self.last = np.zeros(self.n), np.zeros(self.n), None

    def link_torque(self, q, dq, dqr, ddqr):
        p = self.p
        self.motions = link_motions(np.reshape(p["rotation"], (-1, 3, 3)), p["origin"], q, dq, dqr, ddqr, p["gravity"])
        return torques(self.motions, [regressor(*m[:4]) @ t for m, t in zip(self.motions, self.theta, strict=True)])

    def velocity(self, q, dq, qd, dqd, dt):
        error = qd - q
        cutoff = self.p["derivative_cutoff"]
        pole = 0.8 if (dt, cutoff) == (1e-3, 200.0) else math.exp(-cutoff * dt)
        last = error if self.last is None else self.last
        self.rate, self.last = pole * self.rate + (1 - pole) * (error - last) / dt, error
        return dqd - self.rate if self.error_filter else dq

    def add_integral(self, s, dt):
        p = self.p
        for j in range(self.n):
            limits = p["integral_low"][j], p["integral_high"][j]
            self.integral[j] = project(self.integral[j], s[j], p["integral_gain"][j], *limits, dt)
        return self.integral

    def adapt(self, dt):
        p = self.p
        for j, (X, Xr, dXr, g, *_) in enumerate(self.motions):
            psi = regressor(X, Xr, dXr, g).T @ (Xr - X)
            for i in range(13):
                bounds = p["link_parameters_low"][j, i], p["link_parameters_high"][j, i]
                if p["link_adaptation_gain"][j, i] > 0:
                    gain = p["link_adaptation_gain"][j, i]
                    self.theta[j, i] = project(self.theta[j, i], psi[i], gain, *bounds, dt)

    def step(self, q, dq, qd, dqd, ddqd, extra, dt):
        """The torque (n,) of one sample."""
        p, none = self.p, np.zeros(self.n)
        dq = self.velocity(q, dq, qd, dqd, dt)
        lam, kp, e, de = p["position_gain"], p["velocity_gain"], qd - q, dqd - dq
        if self.law == "vdc":
            dqr = dqd + lam * e
            tau = self.link_torque(q, dq, dqr, ddqd + lam * de)
            tau = tau + kp * (dqr - dq) + self.add_integral(dqr - dq, dt)
            if p["link_adaptation"]:
                self.adapt(dt)
        elif self.law in ("pd", "pid"):
            tau = self.link_torque(q, none, none, none) + kp * (de + lam * e)
            if self.law == "pid":
                tau = tau + self.add_integral(de + lam * e, dt)
        elif self.law == "computed_torque":
            a_c = ddqd + 2 * lam * de + lam**2 * e
            tau = self.link_torque(q, dq, dq, a_c) + p["rotor_inertia"] * a_c
        else:
            tau = self.link_torque(qd, dqd, dqd, ddqd) + p["rotor_inertia"] * ddqd
        return tau + extra
