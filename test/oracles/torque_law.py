"""Zhu's adaptive joint torque control for one joint, written down once more in floats, straight from the equations.

Letters as in the paper. Nothing is shared with the law under test but the meaning of the parameters.
"""

import math


class D:
    """D(x)[k] = a D(x)[k-1] + (1 - a)(x[k] - x[k-1])/T; first sample gives 0."""

    def __init__(self, a, T):
        self.a, self.T, self.x, self.d = a, T, None, 0.0

    def __call__(self, x):
        if self.x is not None:
            self.d = self.a * self.d + (1 - self.a) * (x - self.x) / self.T
        self.x = x
        return self.d


def P(value, s, rho, low, high, T):
    if (value <= low and s <= 0) or (value >= high and s >= 0):
        return min(max(value, low), high)
    return min(max(value + T * rho * s, low), high)


def sgn(x):
    return math.copysign(1.0, x) if x else 0.0


class Joint:
    """`p`: values of one joint by the public parameter names; `a`: pole of D; `variant`, `source`, switches by name."""

    def __init__(self, p, variant, source, a, T, kinematic=False, adapt_friction=True, adapt_compliance=True):
        self.p, self.variant, self.source, self.T, self.kinematic = p, variant, source, T, kinematic
        self.adapt_friction, self.adapt_compliance = adapt_friction, adapt_compliance
        names = "qd2 tau tau_r e e2 m y ydd"
        self.filters = {name: D(a, T) for name in names.split()}
        self.theta = [p["coulomb_torque_initial"], p["friction_offset_initial"], p["viscous_positive_initial"]]
        self.theta.append(p["viscous_negative_initial"])
        self.zeta = self.zeta_before = p["torsional_compliance_initial"]
        self.y = None
        self.qd_v_before, self.slope_before = None, 0.0

    def ke(self, theta):
        a, b = self.p["kinematic_cosine"], self.p["kinematic_sine"]
        n = range(1, len(a) + 1)
        value = sum(a[i - 1] * math.cos(i * theta) + b[i - 1] * math.sin(i * theta) for i in n)
        slope = sum(i * (b[i - 1] * math.cos(i * theta) - a[i - 1] * math.sin(i * theta)) for i in n)
        bend = -sum(i * i * (a[i - 1] * math.cos(i * theta) + b[i - 1] * math.sin(i * theta)) for i in n)
        return value, slope, bend

    def step(self, q, q_v, tau, phi, phi_v, tau_r, q_d, q_d_v):
        p, T, f = self.p, self.T, self.filters
        # rates
        slope = 0.0 if self.qd_v_before is None else (q_d_v - self.qd_v_before) / T
        q_d_a = (3 * slope - self.slope_before) / 2
        self.qd_v_before, self.slope_before = q_d_v, slope
        q_a = f["qd2"](q_v)
        tau_v, tau_r_v = f["tau"](tau), f["tau_r"](tau_r)
        e_v = f["e"](q_d - q)
        e_a = f["e2"](e_v)
        m_v = f["m"](q_d - phi)
        if self.source == "error_filter":
            q_v, q_a, phi_v = q_d_v - e_v, q_d_a - e_a, q_d_v - m_v
        # wanted torsion y, y', y''
        d = p["damping_time"]
        zeta_v = (self.zeta - self.zeta_before) / T
        self.zeta_before = self.zeta
        x = self.zeta * tau_r
        x_v = self.zeta * tau_r_v + zeta_v * tau_r
        old = x if self.y is None else self.y
        y = old + T * (x - old) / (d + T)
        self.y = y
        filtered_v, filtered_a = f["y"](y), f["ydd"]((y - old) / T)
        if self.variant == "literal":
            y_v = (x - old) / (d + T)
            y_a = (x_v - y_v) / d
        elif self.variant == "stiffness_only":
            y, y_v, y_a = x, x_v, 0.0
        else:
            y_v, y_a = filtered_v, filtered_a
        # wanted rotor motion
        phi_d, phi_d_v, phi_d_a = q + y, q_v + y_v, q_a + y_a
        if self.kinematic:
            N = p["gear_ratio"]
            value, slope_ke, bend = self.ke(N * phi)
            phi_d -= value
            phi_d_v -= N * slope_ke * q_d_v
            phi_d_a -= N * N * bend * q_d_v**2 + N * slope_ke * q_d_a
        lp, lt = p["motor_position_gain"], p["torque_rate_gain"]
        phi_r_v = phi_d_v + lp * (phi_d - phi) + lt * (tau_r - tau)
        phi_r_a = phi_d_a + lp * (phi_d_v - phi_v) + lt * (tau_r_v - tau_v)
        # torque
        g = 1 + p["load_friction_linear"] * abs(tau) + p["load_friction_quadratic"] * tau**2
        Y = [g * sgn(phi_r_v), 1.0, max(phi_r_v, 0.0), min(phi_r_v, 0.0)]
        s = phi_r_v - phi_v
        u = p["rotor_inertia"] * phi_r_a + sum(a * b for a, b in zip(Y, self.theta, strict=True))
        u += p["motor_velocity_gain"] * s + tau_r + p["torque_gain"] * (tau_r - tau)
        u = min(max(u, -p["motor_torque_limit"]), p["motor_torque_limit"])
        # estimates
        if self.adapt_friction:
            gains = ("coulomb", "offset", "viscous", "viscous")
            bounds = ("coulomb_torque", "friction_offset", "viscous", "viscous")
            for i in range(4):
                low, high = p[f"{bounds[i]}_low"], p[f"{bounds[i]}_high"]
                self.theta[i] = P(self.theta[i], s * Y[i], p[f"adaptation_gain_{gains[i]}"], low, high, T)
        if self.adapt_compliance:
            s_zeta = -(1 + p["torque_gain"]) * tau_r * ((phi_d_v - phi_v) + lp * (phi_d - phi))
            low, high = p["torsional_compliance_low"], p["torsional_compliance_high"]
            self.zeta = P(self.zeta, s_zeta, p["adaptation_gain_compliance"], low, high, T)
        return u
