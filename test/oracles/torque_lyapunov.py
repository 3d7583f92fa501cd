"""Zhu's Lyapunov function V1 of the torque loop with its derivative, and an ideal drive, in continuous time.

Plant: KE = 0, no hysteresis, Zhu (1)-(4). Controller: Zhu (5)-(14) with exact derivatives, algebraic loop solved.
Letters as in the paper; `p` holds numbers by these letters.
"""

import math


def sgn(x):
    return math.copysign(1.0, x) if x else 0.0


def regressor(p, v, tau):
    g = 1 + p["g1"] * abs(tau) + p["g2"] * tau * tau
    return [g * sgn(v), 1.0, max(v, 0.0), min(v, 0.0)]


def kappa(value, s, low, high):
    return 0.0 if (value <= low and s <= 0) or (value >= high and s >= 0) else 1.0


def rates(p, motion, state, u_d=0.0):
    """Time derivatives of (phi, phi', y, theta^, zeta^), and everything that the balance of V1 needs.

    `motion` = q, q', q'', tau_r, tau_r'.
    """
    q, q_v, q_a, tau_r, tau_r_v = motion
    phi, v, y, theta, zeta = state
    k, d, inertia = p["k_f"], p["d"], p["I"]
    tau = k * ((phi - q) + d * (v - q_v))
    y_v = (zeta * tau_r - y) / d
    e, e_v, e_tau = q + y - phi, q_v + y_v - v, tau_r - tau
    s = e_v + p["l_phi"] * e + p["l_tau"] * e_tau
    Y_r, Y = regressor(p, v + s, tau), regressor(p, v, tau)
    s_i = [s * x for x in Y_r]
    s_zeta = -(1 + p["k_tau"]) * tau_r * (e_v + p["l_phi"] * e)
    theta_v = [
        rho * si * kappa(t, si, low, high)
        for rho, si, t, low, high in zip(p["rho"], s_i, theta, p["low"], p["high"], strict=True)
    ]
    zeta_v = p["rho_zeta"] * s_zeta * kappa(zeta, s_zeta, p["zeta_low"], p["zeta_high"])
    y_a = (zeta_v * tau_r + zeta * tau_r_v - y_v) / d
    # I phi'' = u + u_d - F - tau,  u = I phi_r'' + rest,  phi_r'' = known - l_tau k d phi'' (the algebraic loop)
    known = q_a + y_a + p["l_phi"] * e_v + p["l_tau"] * (tau_r_v - k * ((v - q_v) - d * q_a))
    rest = sum(a * b for a, b in zip(Y_r, theta, strict=True)) + p["k_phi"] * s + tau_r + p["k_tau"] * e_tau
    friction = sum(a * b for a, b in zip(Y, p["theta"], strict=True))
    acceleration = (known + (rest + u_d - friction - tau) / inertia) / (1 + p["l_tau"] * k * d)
    s_v = known - p["l_tau"] * k * d * acceleration - acceleration
    found = {"e": e, "e_v": e_v, "e_tau": e_tau, "s": s, "s_v": s_v, "Y": Y, "Y_r": Y_r, "s_i": s_i, "s_zeta": s_zeta}
    return (v, acceleration, y_v, theta_v, zeta_v), found


def value(p, motion, state):
    """V1."""
    _, f = rates(p, motion, state)
    _, _, _, theta, zeta = state
    size = 0.5 * p["I"] * f["s"] ** 2 + 0.5 * (1 + p["k_tau"]) * p["k_f"] * (1 + p["d"] * p["l_phi"]) * f["e"] ** 2
    size += sum((t - h) ** 2 / (2 * rho) for t, h, rho in zip(p["theta"], theta, p["rho"], strict=True))
    return size + p["k_f"] * (1 / p["k_f"] - zeta) ** 2 / (2 * p["rho_zeta"])


def both_sides(p, motion, state, u_d):
    """V1' from its definition, V1' from the terms of the proof, and those terms by name."""
    (_, _, _, theta_v, zeta_v), f = rates(p, motion, state, u_d)
    _, _, _, theta, zeta = state
    miss = [t - h for t, h in zip(p["theta"], theta, strict=True)]
    miss_zeta = 1 / p["k_f"] - zeta
    defined = p["I"] * f["s"] * f["s_v"]
    defined += (1 + p["k_tau"]) * p["k_f"] * (1 + p["d"] * p["l_phi"]) * f["e"] * f["e_v"]
    defined -= sum(m * r / rho for m, r, rho in zip(miss, theta_v, p["rho"], strict=True))
    defined -= p["k_f"] * miss_zeta * zeta_v / p["rho_zeta"]
    terms = {
        "damping": -p["k_phi"] * f["s"] ** 2
        - (1 + p["k_tau"]) * p["k_f"] * (p["d"] * f["e_v"] ** 2 + p["l_phi"] * f["e"] ** 2)
        - (1 + p["k_tau"]) * p["l_tau"] * f["e_tau"] ** 2,
        "disturbance": -f["s"] * u_d,
        "friction": -f["s"] * sum((a - b) * t for a, b, t in zip(f["Y_r"], f["Y"], p["theta"], strict=True)),
        "estimates": sum(m * (si - r / rho) for m, si, r, rho in zip(miss, f["s_i"], theta_v, p["rho"], strict=True)),
        "compliance": p["k_f"] * miss_zeta * (f["s_zeta"] - zeta_v / p["rho_zeta"]),
    }
    return defined, sum(terms.values()), terms
